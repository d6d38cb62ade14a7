//! The half that takes parcels.

use std::collections::VecDeque;
use std::io::{self, IoSlice};
use std::sync::{Arc, OnceLock};

use mom_proto::codec::Form;
use mom_proto::{Compression, Parcel};
use tokio::sync::mpsc;
use tokio::sync::mpsc::error::TrySendError;

use crate::compressed::Packer;
use crate::socket::WriteHalf;
use crate::{Door, NetError, Outgoing, TcpState};

/// Pieces gathered into one system call; half of what Linux takes, two to a parcel.
pub const GATHER: usize = 512;

/// Takes the parcels of a connection.
#[derive(Debug)]
pub struct Writer {
    sink: Sink,
}

#[derive(Debug)]
pub(crate) enum Sink {
    Stream { stream: Stream, form: Form },
    Local(mpsc::Sender<Arc<Parcel>>),
}

/// Where a form's bytes go: through a compressor, once one was begun.
#[derive(Debug)]
pub(crate) struct Stream {
    link: WriteHalf,
    /// What is to be begun where no frame is under way.
    wanted: OnceLock<Compression>,
    packer: OnceLock<Box<Packer>>,
}

impl Stream {
    pub(crate) fn new(link: WriteHalf) -> Stream {
        Stream {
            link,
            wanted: OnceLock::new(),
            packer: OnceLock::new(),
        }
    }

    fn try_write(&self, pieces: &[IoSlice<'_>]) -> io::Result<Option<usize>> {
        match self.packer.get() {
            Some(packer) => packer.try_write(&self.link, pieces),
            None => self.link.try_write(pieces),
        }
    }
}

/// How far a writer came.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress {
    /// All is written.
    Done,
    /// The link takes no more now, or others are to have their turn: wait for [`Writer::ready`].
    Blocked,
}

impl Writer {
    pub(crate) fn new(sink: Sink) -> Writer {
        Writer { sink }
    }

    /// The wire form, none inside a process.
    pub fn form(&self) -> Option<Form> {
        match &self.sink {
            Sink::Stream { form, .. } => Some(*form),
            Sink::Local(_) => None,
        }
    }

    /// What carries the form, none inside a process.
    pub fn door(&self) -> Option<Door> {
        match &self.sink {
            Sink::Stream { stream, .. } => Some(stream.link.door()),
            Sink::Local(_) => None,
        }
    }

    /// Prepares a parcel for this link.
    ///
    /// # Errors
    /// What has no form on the wire.
    pub fn prepare(&self, parcel: Arc<Parcel>) -> Result<Outgoing, NetError> {
        match &self.sink {
            Sink::Stream { form, .. } => Ok(Outgoing::Encoded(form.encode(&parcel)?)),
            Sink::Local(_) => Ok(Outgoing::Parcel(parcel)),
        }
    }

    /// Writes from the front of `queue` as much as the link takes without waiting; what is written leaves it.
    ///
    /// # Errors
    /// A failed link.
    pub fn try_write<T>(&self, queue: &mut VecDeque<T>) -> Result<Progress, NetError>
    where
        T: AsRef<Outgoing> + AsMut<Outgoing>,
    {
        while !queue.is_empty() {
            let blocked = match &self.sink {
                Sink::Stream { stream, .. } => write_stream(stream, queue)?,
                Sink::Local(sender) => write_local(sender, queue)?,
            };
            if blocked {
                return Ok(Progress::Blocked);
            }
        }
        Ok(Progress::Done)
    }

    /// Writes the front of these pieces, as much as the link takes without waiting. Gives how many bytes that was,
    /// none if the link takes nothing now. Only for a link that has a form.
    ///
    /// # Errors
    /// A failed link.
    pub fn try_write_pieces(&self, pieces: &[IoSlice<'_>]) -> Result<Option<usize>, NetError> {
        let Sink::Stream { stream, .. } = &self.sink else {
            return Err(io::Error::from(io::ErrorKind::Unsupported).into());
        };
        Ok(stream.try_write(pieces)?)
    }

    /// Passes a parcel to a peer in this process; false if it takes none now. Only for a link without a form.
    ///
    /// # Errors
    /// A peer that is gone.
    pub fn try_pass(&self, parcel: &Arc<Parcel>) -> Result<bool, NetError> {
        let Sink::Local(sender) = &self.sink else {
            return Err(io::Error::from(io::ErrorKind::Unsupported).into());
        };
        match sender.try_send(Arc::clone(parcel)) {
            Ok(()) => Ok(true),
            Err(TrySendError::Full(_)) => Ok(false),
            Err(TrySendError::Closed(_)) => Err(closed()),
        }
    }

    /// The state of the network below, none inside a process or where the system does not tell.
    pub fn link(&self) -> Option<TcpState> {
        match &self.sink {
            Sink::Stream { stream, .. } => {
                let link = stream.link.link();
                match stream.packer.get() {
                    // As if it knew the bytes that were taken.
                    Some(packer) => link.map(|link| TcpState {
                        acknowledged: link.acknowledged.saturating_add_signed(packer.saved()),
                        ..link
                    }),
                    None => link,
                }
            }
            Sink::Local(_) => None,
        }
    }

    /// How many bytes fewer went out than were written: what compressing has saved.
    pub fn saved(&self) -> i64 {
        match &self.sink {
            Sink::Stream { stream, .. } => stream.packer.get().map_or(0, |packer| packer.saved()),
            Sink::Local(_) => 0,
        }
    }

    /// Compresses so all that is written from the next boundary between two frames on, for as long as this writer lives. Only one way is
    /// ever begun.
    pub fn compress(&self, way: Compression) {
        if let Sink::Stream { stream, .. } = &self.sink {
            // Another one is begun already.
            let _ = stream.wanted.set(way);
        }
    }

    /// No frame is under way: what was to be begun is.
    ///
    /// # Errors
    /// No memory for it.
    pub(crate) fn at_boundary(&self) -> Result<(), NetError> {
        if let Sink::Stream { stream, form } = &self.sink
            && let Some(way) = stream.wanted.get()
            && stream.packer.get().is_none()
        {
            let packer = Packer::new(*way, form.is_binary())?;
            if stream.packer.set(Box::new(packer)).is_ok() {
                stream.link.begin_binary();
            }
        }
        Ok(())
    }

    /// Waits until the link takes more; where what is written is compressed, until others have had their turn.
    ///
    /// # Errors
    /// A failed link.
    pub async fn ready(&self) -> Result<(), NetError> {
        match &self.sink {
            Sink::Stream { stream, .. } => {
                if stream.packer.get().is_some_and(|packer| packer.next_turn()) {
                    tokio::task::yield_now().await;
                }
                Ok(stream.link.writable().await?)
            }
            Sink::Local(sender) => sender.reserve().await.map(drop).map_err(|_| closed()),
        }
    }

    /// Encodes and writes one parcel, waiting for the link.
    ///
    /// # Errors
    /// A failed link, or a parcel that has no form on the wire.
    pub async fn send(&mut self, parcel: Parcel) -> Result<(), NetError> {
        let mut queue = VecDeque::from([self.prepare(Arc::new(parcel))?]);
        while self.try_write(&mut queue)? == Progress::Blocked {
            self.ready().await?;
        }
        Ok(())
    }

    /// Writes one parcel as far as the link takes it at once, and that nothing more comes from this end.
    ///
    /// # Errors
    /// As [`Writer::send`].
    pub fn try_last_word(&self, parcel: Parcel) -> Result<(), NetError> {
        let mut queue = VecDeque::from([self.prepare(Arc::new(parcel))?]);
        if let Sink::Stream { stream, .. } = &self.sink
            && let Some(packer) = stream.packer.get()
        {
            packer.next_turn();
        }
        self.try_write(&mut queue)?;
        self.finish();
        Ok(())
    }

    /// Says that nothing more comes from this end. In a process that is when the writer is dropped.
    pub fn finish(&self) {
        if let Sink::Stream { stream, .. } = &self.sink {
            stream.link.finish();
        }
    }
}

fn write_stream<T>(stream: &Stream, queue: &mut VecDeque<T>) -> Result<bool, NetError>
where
    T: AsRef<Outgoing> + AsMut<Outgoing>,
{
    let mut slices = Vec::with_capacity(GATHER.min(queue.len() * 2));
    for outgoing in queue.iter() {
        if let Outgoing::Encoded(encoded) = outgoing.as_ref() {
            let pieces = [&encoded.head, &encoded.body];
            slices.extend(
                pieces
                    .into_iter()
                    .filter(|piece| !piece.is_empty())
                    .map(|piece| IoSlice::new(piece)),
            );
        }
        if slices.len() >= GATHER {
            break;
        }
    }
    let Some(mut written) = stream.try_write(&slices)? else {
        return Ok(true);
    };
    while let Some(front) = queue.front_mut() {
        written = front.as_mut().advance(written);
        if !front.as_ref().is_empty() {
            break;
        }
        queue.pop_front();
    }
    Ok(false)
}

fn write_local<T>(sender: &mpsc::Sender<Arc<Parcel>>, queue: &mut VecDeque<T>) -> Result<bool, NetError>
where
    T: AsRef<Outgoing>,
{
    while let Some(front) = queue.front() {
        if let Outgoing::Parcel(parcel) = front.as_ref() {
            match sender.try_send(Arc::clone(parcel)) {
                Ok(()) => {}
                Err(TrySendError::Full(_)) => return Ok(true),
                Err(TrySendError::Closed(_)) => return Err(closed()),
            }
        }
        queue.pop_front();
    }
    Ok(false)
}

fn closed() -> NetError {
    io::Error::from(io::ErrorKind::BrokenPipe).into()
}
