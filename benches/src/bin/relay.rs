//! The floor for any hub: forwards each frame (big-endian u32 length, then so many bytes) to all other
//! connections, and knows nothing else.
//!
//! With `--raw` not even frames: it hands on whatever it has read.
//!
//! One thread, because a hop to another thread costs more than anything that is done here; reads as much as
//! there is, writes all whole frames of it at once to each receiver.

use std::cell::RefCell;
use std::io::{self, ErrorKind, Write};
use std::rc::Rc;

use clap::Parser;
use tokio::io::AsyncReadExt;
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Mutex;
use tokio::task::LocalSet;

/// Room for what arrives at once; grows to the largest frame.
const ROOM: usize = 256 * 1024;
const PREFIX: usize = 4;
const LARGEST: usize = 64 * 1024 * 1024;

/// The writing half of a connection; frames of several senders must not mix.
type Sink = Rc<Mutex<OwnedWriteHalf>>;

/// All connections with their numbers, replaced as a whole, so that a reader holds nothing while it writes.
type Sinks = Rc<RefCell<Rc<Vec<(u64, Sink)>>>>;

/// Forward what each connection sends to all others.
#[derive(Clone, Parser)]
struct Cli {
    /// Where to listen.
    #[arg(long, default_value = "127.0.0.1:0")]
    listen: String,
    /// Do not look for frames: only right for one sender at a time.
    #[arg(long)]
    raw: bool,
    /// Also back to where it came from.
    #[arg(long)]
    echo: bool,
}

fn main() -> io::Result<()> {
    let cli = Rc::new(Cli::parse());
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_io()
        .build()?;
    LocalSet::new().block_on(&runtime, listen(cli))
}

async fn listen(cli: Rc<Cli>) -> io::Result<()> {
    let listener = TcpListener::bind(&cli.listen).await?;
    let mut out = io::stdout();
    writeln!(out, "listening at tcp://{}", listener.local_addr()?)?;
    out.flush()?;
    let sinks = Sinks::default();
    for number in 0.. {
        let (stream, _) = listener.accept().await?;
        let (sinks, cli) = (Rc::clone(&sinks), Rc::clone(&cli));
        tokio::task::spawn_local(async move {
            // A connection that fails is one that ended.
            let _ = serve(&cli, &sinks, number, stream).await;
            change(&sinks, |all| all.retain(|(known, _)| *known != number));
        });
    }
    Ok(())
}

async fn serve(cli: &Cli, sinks: &Sinks, number: u64, stream: TcpStream) -> io::Result<()> {
    stream.set_nodelay(true)?;
    let (mut reader, writer) = stream.into_split();
    let sink = Rc::new(Mutex::new(writer));
    change(sinks, |all| all.push((number, Rc::clone(&sink))));
    write(&sink, &[0; PREFIX]).await?;
    forward(cli, sinks, number, &mut reader).await
}

async fn forward(cli: &Cli, sinks: &Sinks, number: u64, reader: &mut OwnedReadHalf) -> io::Result<()> {
    let mut buffer = vec![0; ROOM];
    let mut filled = 0;
    loop {
        let length = reader.read(&mut buffer[filled..]).await?;
        if length == 0 {
            return Ok(());
        }
        filled += length;
        let (whole, next) = match cli.raw {
            true => (filled, PREFIX),
            false => whole_frames(&buffer[..filled])?,
        };
        if whole > 0 {
            let all = Rc::clone(&sinks.borrow());
            for (_, other) in all.iter().filter(|(other, _)| cli.echo || *other != number) {
                // The other's own reader finds out that it is gone.
                let _ = write(other, &buffer[..whole]).await;
            }
            buffer.copy_within(whole..filled, 0);
            filled -= whole;
        }
        if next > buffer.len() {
            buffer.resize(next, 0);
        }
    }
}

async fn write(sink: &Sink, mut bytes: &[u8]) -> io::Result<()> {
    let sink = sink.lock().await;
    while !bytes.is_empty() {
        match sink.try_write(bytes) {
            Ok(written) => bytes = &bytes[written..],
            Err(error) if error.kind() == ErrorKind::WouldBlock => sink.writable().await?,
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

/// The length of all whole frames at the front, and the size of the frame after them as far as it is known.
fn whole_frames(bytes: &[u8]) -> io::Result<(usize, usize)> {
    let mut end = 0;
    while let Some(length) = bytes[end..].first_chunk::<PREFIX>() {
        let size = PREFIX + u32::from_be_bytes(*length) as usize;
        if size > LARGEST {
            return Err(ErrorKind::InvalidData.into());
        }
        if bytes.len() - end < size {
            return Ok((end, size));
        }
        end += size;
    }
    Ok((end, PREFIX))
}

fn change(sinks: &Sinks, change: impl FnOnce(&mut Vec<(u64, Sink)>)) {
    change(Rc::make_mut(&mut sinks.borrow_mut()));
}
