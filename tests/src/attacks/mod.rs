//! What permitted peers do that others must not pay for: the tests look at what it does, `bench-isolation` at what it costs.

mod attackers;
mod rounds;
mod strangers;

use std::path::PathBuf;

pub use attackers::Attackers;

use crate::programs::project;

/// The configuration of a broker that is attacked.
pub fn configuration() -> PathBuf {
    project().join("tests/attacked.toml")
}

/// One thing that one to a few hundred permitted peers do, again and again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Attack {
    /// Make thousands of tokens in a session, and delete it.
    LargeDelete,
    /// Send 8 MiB of MessagePack nils where a member speaks XML.
    Nils,
    /// Join and leave a channel that keeps 1 MiB.
    Rejoin,
    /// Send 4 MiB in slots to a channel that keeps messages.
    LargeSlots,
    /// Ask to join with 8 MiB of content.
    LargeRequest,
    /// Send 8 MiB of XML.
    LargeXml,
    /// List a session with thousands of children.
    LargeList,
    /// Join and leave among 200 members.
    Crowd,
    /// Join 200 channels, and leave them together.
    Leavers,
    /// Send 0.9 MB of doubles ten times a second, with a viewer that speaks XML.
    Lidar,
    /// Send to peers that read nothing.
    Sleepers,
    /// Begin parcels in chunks, and end none.
    Chunks,
    /// Send WebSocket frames of nothing, before login.
    Nothing,
    /// Ping, acknowledge and log in with 8 MiB of MessagePack nils.
    SignsOfLife,
    /// Send 1 MB of doubles, fleeting, as fast as the hub takes it, where a member speaks XML.
    LaterXml,
    /// Say 60 KB of the highest priority to a robot, again and again.
    Urgent,
    /// Send to a device that reads nothing, and owns nothing of it.
    SlowDevice,
    /// Ask for pages that there are not, before login, without waiting for answers.
    Heads,
    /// Be a thousand guests of one channel, and be cut off in one moment.
    Reset,
}

impl Attack {
    /// All of them.
    pub const ALL: [Attack; 19] = [
        Attack::LargeDelete,
        Attack::Nils,
        Attack::Rejoin,
        Attack::LargeSlots,
        Attack::LargeRequest,
        Attack::LargeXml,
        Attack::LargeList,
        Attack::Crowd,
        Attack::Leavers,
        Attack::Lidar,
        Attack::Sleepers,
        Attack::Chunks,
        Attack::Nothing,
        Attack::SignsOfLife,
        Attack::LaterXml,
        Attack::Urgent,
        Attack::SlowDevice,
        Attack::Heads,
        Attack::Reset,
    ];

    /// Its word on a command line.
    pub fn word(self) -> &'static str {
        match self {
            Attack::LargeDelete => "large-delete",
            Attack::Nils => "nils",
            Attack::Rejoin => "rejoin",
            Attack::LargeSlots => "large-slots",
            Attack::LargeRequest => "large-request",
            Attack::LargeXml => "large-xml",
            Attack::LargeList => "large-list",
            Attack::Crowd => "crowd",
            Attack::Leavers => "leavers",
            Attack::Lidar => "lidar",
            Attack::Sleepers => "sleepers",
            Attack::Chunks => "chunks",
            Attack::Nothing => "nothing",
            Attack::SignsOfLife => "signs-of-life",
            Attack::LaterXml => "later-xml",
            Attack::Urgent => "urgent",
            Attack::SlowDevice => "slow-device",
            Attack::Heads => "heads",
            Attack::Reset => "reset",
        }
    }

    /// It in a few words, for a table.
    pub fn describe(self) -> &'static str {
        match self {
            Attack::LargeDelete => "make 5 000 tokens in a session and delete it",
            Attack::Nils => "8 MiB of MessagePack nils to a channel with an XML member",
            Attack::Rejoin => "join and leave a channel that keeps 1 MiB, two peers at the permitted rate",
            Attack::LargeSlots => "4 MiB in slots to a channel that keeps messages",
            Attack::LargeRequest => "`context join` with 8 MiB of content",
            Attack::LargeXml => "8 MiB of XML",
            Attack::LargeList => "`list` of a session with 9 000 children",
            Attack::Crowd => "join and leave among 200 members",
            Attack::Leavers => "join 200 channels of 16 members each, and leave their session",
            Attack::Lidar => "no malice: 0.9 MB of doubles at 10 Hz with an XML viewer",
            Attack::Sleepers => "messages of 64 KiB to 16 peers that read nothing",
            Attack::Chunks => "parcels of 8 MiB in chunks that never end, on 16 connections",
            Attack::Nothing => "strangers' pings and empty frames on 4 WebSockets",
            Attack::SignsOfLife => "`time ping`, `time ack` and `login` with 8 MiB of MessagePack nils",
            Attack::LaterXml => "1 MB fleeting messages, as many as are taken, with an XML reader",
            Attack::Urgent => "60 KB of the highest priority to the robot, as many as are taken",
            Attack::SlowDevice => "messages of 64 KiB to a device that reads nothing",
            Attack::Heads => {
                "strangers' requests for pages that there are not, 1 000 at once on 4 connections"
            }
            Attack::Reset => "1 000 guests of one channel are reset at once",
        }
    }

    /// What its peers hear of it, as codes and events. Beside that they may be told to try later.
    pub fn hears(self) -> &'static [&'static str] {
        match self {
            Attack::Nils => &["dropped: bad-content"],
            Attack::LargeSlots | Attack::LargeRequest | Attack::SignsOfLife => &["too-long"],
            Attack::Nothing => &["closed: 1008"],
            Attack::Sleepers | Attack::LaterXml => &["dropped: queue-full"],
            Attack::LargeDelete
            | Attack::Rejoin
            | Attack::LargeXml
            | Attack::LargeList
            | Attack::Crowd
            | Attack::Leavers
            | Attack::Lidar
            | Attack::Chunks
            | Attack::Urgent
            | Attack::SlowDevice
            | Attack::Reset => &[],
            Attack::Heads => &["status: 404"],
        }
    }

    /// The attack of this word.
    pub fn named(word: &str) -> Option<Attack> {
        Attack::ALL.into_iter().find(|attack| attack.word() == word)
    }
}
