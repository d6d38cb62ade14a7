//! The header that begins each packet (S14).

use core::fmt;

/// The version of the protocol in each header.
pub const VERSION: u8 = 1;

/// Which way a packet goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Direction {
    /// From the middle to the robot.
    Down,
    /// From the robot to the middle.
    Up,
}

/// What a packet is; the direction is part of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Type {
    /// The middle asks for a session.
    Hello = 0x00,
    /// The middle's part of the simulacrum, one each period.
    Data = 0x01,
    /// Activation and period, as the middle wants them.
    Control = 0x02,
    /// A part of a blob for the robot.
    Fragment = 0x03,
    /// The middle ends the session (S23).
    End = 0x04,
    /// The robot gives a session.
    Welcome = 0x80,
    /// The robot's part of the simulacrum, one each period.
    UpData = 0x81,
    /// Activation, as it is.
    UpControl = 0x82,
    /// A part of a blob for the middle.
    UpFragment = 0x83,
    /// The robot ends the session (S23).
    UpEnd = 0x84,
    /// The robot gives no session.
    Refusal = 0x85,
}

impl Type {
    /// The type of a number on the wire.
    #[must_use]
    pub const fn of(number: u8) -> Option<Type> {
        Some(match number {
            0x00 => Type::Hello,
            0x01 => Type::Data,
            0x02 => Type::Control,
            0x03 => Type::Fragment,
            0x04 => Type::End,
            0x80 => Type::Welcome,
            0x81 => Type::UpData,
            0x82 => Type::UpControl,
            0x83 => Type::UpFragment,
            0x84 => Type::UpEnd,
            0x85 => Type::Refusal,
            _ => return None,
        })
    }
}

/// Why a datagram was dropped.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Dropped {
    /// It is shorter than what it must have.
    Short,
    /// Its version is another one.
    Version,
    /// It is for another model.
    Model,
    /// Its type is unknown, or not for this end, or not now.
    Type,
    /// It belongs to no session that is known here.
    Session,
    /// It is sealed where it must not be, or open where it must be sealed.
    Encryption,
    /// Its tag or its code is wrong: another key, or changed on the way.
    Sealed,
    /// Its sequence was heard before.
    Replayed,
    /// Its sequence is too old to know whether it was heard before.
    Old,
    /// Its device map is cut off, or names what the model has not.
    Map,
    /// Its payload does not fit its map, or its type.
    Payload,
    /// A hello while another session is alive.
    Busy,
    /// More hellos than are answered in a second.
    Flood,
}

impl Dropped {
    /// All reasons.
    pub const ALL: [Dropped; 13] = [
        Dropped::Short,
        Dropped::Version,
        Dropped::Model,
        Dropped::Type,
        Dropped::Session,
        Dropped::Encryption,
        Dropped::Sealed,
        Dropped::Replayed,
        Dropped::Old,
        Dropped::Map,
        Dropped::Payload,
        Dropped::Busy,
        Dropped::Flood,
    ];

    /// One word.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Dropped::Short => "short",
            Dropped::Version => "version",
            Dropped::Model => "model",
            Dropped::Type => "type",
            Dropped::Session => "session",
            Dropped::Encryption => "encryption",
            Dropped::Sealed => "sealed",
            Dropped::Replayed => "replayed",
            Dropped::Old => "old",
            Dropped::Map => "map",
            Dropped::Payload => "payload",
            Dropped::Busy => "busy",
            Dropped::Flood => "flood",
        }
    }
}

impl fmt::Display for Dropped {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.word())
    }
}

impl core::error::Error for Dropped {}

/// How many datagrams were accepted, and how many dropped for each reason; a count stays at its highest value.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    accepted: u32,
    dropped: [u32; Dropped::ALL.len()],
}

impl Counters {
    pub(crate) const NONE: Counters = Counters {
        accepted: 0,
        dropped: [0; Dropped::ALL.len()],
    };

    /// Datagrams that were accepted.
    #[must_use]
    pub fn accepted(&self) -> u32 {
        self.accepted
    }

    /// Datagrams that were dropped for this reason.
    #[must_use]
    pub fn dropped(&self, reason: Dropped) -> u32 {
        self.dropped.get(reason as usize).copied().unwrap_or(0)
    }

    /// All reasons with their counts.
    pub fn iter(&self) -> impl Iterator<Item = (Dropped, u32)> + '_ {
        Dropped::ALL.into_iter().zip(self.dropped)
    }

    pub(crate) fn count(&mut self, outcome: Result<(), Dropped>) -> Result<(), Dropped> {
        let counter = match outcome {
            Ok(()) => Some(&mut self.accepted),
            Err(reason) => self.dropped.get_mut(reason as usize),
        };
        if let Some(counter) = counter {
            *counter = counter.saturating_add(1);
        }
        outcome
    }
}

/// The header of a packet: 20 bytes, big-endian (S14).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// @0: [`VERSION`].
    pub version: u8,
    /// @1: the model's number.
    pub model: u16,
    /// @3: 0 none, 1 ChaCha20-Poly1305.
    pub encryption: u8,
    /// @4: what it is.
    pub kind: Type,
    /// @5: counts all packets of a direction of a session, from 0 (S15).
    pub sequence: u16,
    /// @7: ms of the sender's own clock.
    pub stamp: u32,
    /// @11: all zero in a hello and in a refusal.
    pub session: [u8; 6],
    /// @17: the sequence of the newest data packet heard from the other end, 0xFFFF before the first.
    pub last: u16,
    /// @19: down: +1 for "clear your buffers"; up: how many buffers are free (S16).
    pub buffers: u8,
}

impl Header {
    /// Bytes of a header.
    pub const LEN: usize = 20;

    /// The bytes.
    #[must_use]
    pub fn encode(&self) -> [u8; Header::LEN] {
        let [m0, m1] = self.model.to_be_bytes();
        let [s0, s1] = self.sequence.to_be_bytes();
        let [t0, t1, t2, t3] = self.stamp.to_be_bytes();
        let [i0, i1, i2, i3, i4, i5] = self.session;
        let [l0, l1] = self.last.to_be_bytes();
        [
            self.version,
            m0,
            m1,
            self.encryption,
            self.kind as u8,
            s0,
            s1,
            t0,
            t1,
            t2,
            t3,
            i0,
            i1,
            i2,
            i3,
            i4,
            i5,
            l0,
            l1,
            self.buffers,
        ]
    }

    /// The header that a packet begins with. The version and the numbers are for the caller to judge.
    ///
    /// # Errors
    ///
    /// [`Dropped::Short`], and [`Dropped::Type`] for an unknown type.
    pub fn decode(packet: &[u8]) -> Result<Header, Dropped> {
        let Some(
            &[
                version,
                m0,
                m1,
                encryption,
                kind,
                s0,
                s1,
                t0,
                t1,
                t2,
                t3,
                i0,
                i1,
                i2,
                i3,
                i4,
                i5,
                l0,
                l1,
                buffers,
            ],
        ) = packet.first_chunk::<{ Header::LEN }>()
        else {
            return Err(Dropped::Short);
        };
        Ok(Header {
            version,
            model: u16::from_be_bytes([m0, m1]),
            encryption,
            kind: Type::of(kind).ok_or(Dropped::Type)?,
            sequence: u16::from_be_bytes([s0, s1]),
            stamp: u32::from_be_bytes([t0, t1, t2, t3]),
            session: [i0, i1, i2, i3, i4, i5],
            last: u16::from_be_bytes([l0, l1]),
            buffers,
        })
    }
}
