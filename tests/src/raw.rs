//! A connection that sends whatever bytes it is told to, and reads what comes back.

use std::io::{self, ErrorKind};
use std::net::{IpAddr, SocketAddr};
use std::time::Duration;

use bytes::BytesMut;
use mom_proto::binary::{BinaryDecoder, PREFACE};
use mom_proto::codec::{Decoder, Form, Frame};
use mom_proto::{Code, Compression, Family, Limit, Limits, Map, Parcel, Path, Value, WireError};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpSocket, TcpStream};
use tokio::time::timeout;

/// Nothing in a test takes longer than this, however busy the machine is.
pub const PATIENCE: Duration = Duration::from_secs(120);

/// A raw connection to a broker.
#[derive(Debug)]
pub struct Raw {
    stream: TcpStream,
    input: BytesMut,
    decoder: Decoder,
    form: Form,
    last_id: u64,
    /// As the hub calls it.
    name: String,
}

impl Raw {
    /// Connects, and says the preface where the form has one.
    ///
    /// # Panics
    /// If the broker cannot be reached.
    pub async fn connect(address: SocketAddr, form: Form) -> Raw {
        let stream = TcpStream::connect(address).await.expect("the broker listens");
        Raw::start(stream, form).await
    }

    /// Connects with a small receive buffer in the kernel, for a peer that is slow to read.
    ///
    /// # Panics
    /// If the broker cannot be reached.
    pub async fn connect_small(address: SocketAddr, form: Form) -> Raw {
        let socket = TcpSocket::new_v4().expect("a socket");
        socket.set_recv_buffer_size(4096).expect("a socket option");
        let stream = socket.connect(address).await.expect("the broker listens");
        Raw::start(stream, form).await
    }

    /// Connects from another address of this machine: all of 127.0.0.0/8 is loopback.
    ///
    /// # Panics
    /// If the broker cannot be reached from there.
    pub async fn connect_from(from: IpAddr, address: SocketAddr, form: Form) -> Raw {
        let socket = TcpSocket::new_v4().expect("a socket");
        socket
            .bind(SocketAddr::new(from, 0))
            .expect("an address of loopback");
        let stream = socket.connect(address).await.expect("the broker listens");
        Raw::start(stream, form).await
    }

    /// Connects and logs in as this user of the lab.
    pub async fn login(address: SocketAddr, form: Form, user: &str) -> Raw {
        let mut raw = Raw::connect(address, form).await;
        raw.log_in(user).await;
        raw
    }

    async fn start(stream: TcpStream, form: Form) -> Raw {
        stream.set_nodelay(true).expect("a socket option");
        let limits = Limits::default();
        let mut decoder = match form {
            Form::Binary | Form::Packed => Decoder::Binary(Box::new(BinaryDecoder::for_peer(&limits))),
            Form::Xml | Form::Json => Decoder::new(form, &limits),
        };
        if form == Form::Packed {
            decoder.take_packed();
        }
        let mut raw = Raw {
            stream,
            input: BytesMut::new(),
            decoder,
            form,
            last_id: 0,
            name: String::new(),
        };
        if form.is_binary() {
            raw.send(&PREFACE).await;
        }
        raw
    }

    /// Proves to be a user of the lab.
    ///
    /// # Panics
    /// If that is refused.
    pub async fn log_in(&mut self, user: &str) {
        self.try_log_in(user).await.expect("a user of the lab");
    }

    /// Tries to log in with the password of a user of the lab, or as a guest.
    ///
    /// # Errors
    /// What the broker answered.
    ///
    /// # Panics
    /// If the connection ends before.
    pub async fn try_log_in(&mut self, user: &str) -> Result<(), WireError> {
        let mut content = match user {
            "guest" => Map::new().with("guest", true),
            user => Map::new().with("name", user).with("password", user),
        };
        if self.form == Form::Packed {
            content.set("compress", vec![Value::from(Compression::Zstd.word())]);
        }
        let login = Parcel::new(Family::Login, "login").content(content);
        let welcome = self.ask(login).await?.value();
        let name = welcome.get("peer").and_then(Value::as_str);
        self.name = name.expect("the hub gives a name").to_owned();
        self.decoder.set_limits(&told(&welcome));
        Ok(())
    }

    /// The name that the hub gave at login.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The wire form.
    pub fn form(&self) -> Form {
        self.form
    }

    /// Writes bytes. A broker that has closed already does not matter: what it said is read later.
    ///
    /// # Panics
    /// If the broker neither takes them nor closes.
    pub async fn send(&mut self, bytes: &[u8]) {
        let sent = timeout(PATIENCE, self.stream.write_all(bytes)).await;
        let _ = sent.expect("the broker reads or closes");
    }

    /// Writes bytes, however long the broker lets them wait.
    ///
    /// # Errors
    /// A connection that has ended.
    pub async fn send_patiently(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.stream.write_all(bytes).await
    }

    /// Writes bytes until the broker closes.
    ///
    /// # Panics
    /// If it does not.
    pub async fn send_until_closed(&mut self, bytes: &[u8]) {
        let endless = async { while self.stream.write_all(bytes).await.is_ok() {} };
        timeout(PATIENCE, endless).await.expect("the broker closes");
    }

    /// Writes a parcel.
    ///
    /// # Panics
    /// If it has no form on the wire.
    pub async fn send_parcel(&mut self, parcel: &Parcel) {
        let encoded = self
            .form
            .encode(parcel)
            .expect("a parcel with a form on the wire");
        self.send(&encoded.to_vec()).await;
    }

    /// The next parcel, or `None` when the broker has closed.
    ///
    /// # Panics
    /// If nothing comes, or what comes is not a parcel.
    pub async fn next(&mut self) -> Option<Parcel> {
        timeout(PATIENCE, self.try_next())
            .await
            .expect("the broker answers or closes")
    }

    /// What comes within this time: nothing, or a parcel, or the end of the connection.
    pub async fn next_within(&mut self, time: Duration) -> Option<Option<Parcel>> {
        timeout(time, self.try_next()).await.ok()
    }

    async fn try_next(&mut self) -> Option<Parcel> {
        loop {
            match self
                .decoder
                .decode(&mut self.input)
                .expect("what the broker says is well-formed")
            {
                Some(Frame::Parcel(parcel)) => return Some(*parcel),
                Some(Frame::Malformed { error, .. }) => {
                    panic!("the broker sent what it would refuse: {error}")
                }
                None => {}
            }
            match self.stream.read_buf(&mut self.input).await {
                Ok(0) => return None,
                Ok(_) => {}
                Err(error) if is_end(&error) => return None,
                Err(error) => panic!("{error}"),
            }
        }
    }

    /// The next parcel of this class; others before it are skipped.
    ///
    /// # Panics
    /// If the connection ends before.
    pub async fn next_of(&mut self, family: Family, name: &str) -> Parcel {
        loop {
            let parcel = self.next().await;
            let parcel = parcel.unwrap_or_else(|| panic!("closed before {family} {name} came"));
            if parcel.is(family, name) {
                return parcel;
            }
        }
    }

    /// Asks, and waits for the answer; other parcels before it are skipped.
    ///
    /// # Errors
    /// What the broker answered.
    ///
    /// # Panics
    /// If the connection ends before.
    pub async fn ask(&mut self, parcel: Parcel) -> Result<Parcel, WireError> {
        let id = self.post(parcel).await;
        self.answer(id).await
    }

    /// Sends a parcel with a new id, and gives the id.
    pub async fn post(&mut self, parcel: Parcel) -> u64 {
        self.last_id += 1;
        self.send_parcel(&parcel.id(self.last_id)).await;
        self.last_id
    }

    /// Waits for the answer to the parcel of this id.
    ///
    /// # Errors
    /// What the broker answered.
    ///
    /// # Panics
    /// If the connection ends before.
    pub async fn answer(&mut self, id: u64) -> Result<Parcel, WireError> {
        loop {
            let parcel = self.next().await.expect("closed before the answer came");
            if parcel.reference == Some(id) {
                return match parcel.family {
                    Family::Error => Err(WireError::from_parcel(&parcel)),
                    _ => Ok(parcel),
                };
            }
        }
    }

    /// Asks for something about a context, without content.
    ///
    /// # Errors
    /// What the broker answered.
    pub async fn ask_about(&mut self, family: Family, name: &str, path: &str) -> Result<Value, WireError> {
        let parcel = Parcel::new(family, name).context(at(path));
        self.ask(parcel).await.map(|reply| reply.value())
    }

    /// The number of a channel's newest stop, which an unstop names.
    ///
    /// # Panics
    /// If the broker does not say.
    pub async fn newest_stop(&mut self, path: &str) -> Value {
        let info = self.ask_about(Family::Context, "info", path).await;
        let info = info.unwrap_or_else(|error| panic!("info {path}: {error}"));
        let number = info.get("stop").and_then(|stop| stop.get("number"));
        number.cloned().expect("a number")
    }

    /// Joins contexts, parents first.
    ///
    /// # Panics
    /// If that is refused.
    pub async fn join(&mut self, paths: &[&str]) {
        for path in paths {
            let joined = self.ask_about(Family::Context, "join", path).await;
            joined.unwrap_or_else(|error| panic!("cannot join {path}: {error}"));
        }
    }

    /// The next error that refers to no parcel, or to one that was not sent with [`Raw::post`].
    ///
    /// # Panics
    /// If the connection ends without one.
    pub async fn next_error(&mut self) -> WireError {
        loop {
            let parcel = self.next().await.expect("closed without an error");
            if parcel.family == Family::Error {
                return WireError::from_parcel(&parcel);
            }
        }
    }

    /// Checks that the connection lives: a ping is answered, and nothing is refused before it.
    ///
    /// # Panics
    /// If not.
    pub async fn check_alive(&mut self) {
        let pong = self.ask(Parcel::new(Family::Time, "ping")).await;
        assert!(pong.is_ok_and(|pong| pong.is(Family::Time, "pong")));
    }

    /// Checks that the connection ends and nothing more is said but events.
    ///
    /// # Panics
    /// If it does not end, or an answer comes.
    pub async fn check_closed(&mut self) {
        while let Some(parcel) = self.next().await {
            assert_eq!(parcel.family, Family::Event, "after the last error: {parcel:?}");
        }
    }

    /// Ends the connection so that the broker sees a reset, as of a machine that was switched off and on.
    ///
    /// # Panics
    /// If the system does not know how.
    pub fn reset(self) {
        self.stream.set_zero_linger().expect("a socket option");
    }

    /// Whether the broker has closed; what it said before is kept, to be read.
    ///
    /// # Panics
    /// If the connection fails.
    pub async fn has_ended(&mut self) -> bool {
        loop {
            match self.stream.try_read_buf(&mut self.input) {
                Ok(0) => return true,
                Ok(_) => {}
                Err(error) if error.kind() == ErrorKind::WouldBlock => return false,
                Err(error) if is_end(&error) => return true,
                Err(error) => panic!("{error}"),
            }
        }
    }

    /// All bytes up to the end.
    ///
    /// # Panics
    /// If there is none.
    pub async fn read_to_end(&mut self) -> Vec<u8> {
        let mut bytes = std::mem::take(&mut self.input).to_vec();
        match timeout(PATIENCE, self.stream.read_to_end(&mut bytes)).await {
            Ok(Err(error)) if !is_end(&error) => panic!("{error}"),
            Ok(_) => bytes,
            Err(_) => panic!("the broker does not close"),
        }
    }

    /// Reads to the end and gives the code of the last error.
    pub async fn last_error(&mut self) -> Option<Code> {
        let mut last = None;
        while let Some(parcel) = self.next().await {
            if parcel.family == Family::Error {
                last = Some(WireError::from_parcel(&parcel).code);
            }
        }
        last
    }
}

/// What the hub may send by what it said at login: of its limits only the size of a parcel binds itself, too.
pub(crate) fn told(welcome: &Value) -> Limits {
    let most = welcome.get("limits").and_then(|limits| limits.get("parcel"));
    Limits {
        parcel: most
            .and_then(Value::as_int)
            .map_or(Limit::Unlimited, |most| Limit::At(most.unsigned_abs())),
        slots: usize::MAX,
        attribute_size: usize::MAX,
        ..Limits::default()
    }
}

/// The path of a test.
///
/// # Panics
/// If it is none.
pub fn at(path: &str) -> Path {
    Path::parse(path).expect("a path")
}

/// A message to a channel.
pub fn message(name: &str, path: &str, content: impl Into<Value>) -> Parcel {
    Parcel::new(Family::Message, name)
        .context(at(path))
        .content(content.into())
}

// A broker that closes while bytes of ours are under way resets the connection; what it said before is read.
fn is_end(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::ConnectionReset | ErrorKind::BrokenPipe)
}
