//! The one table of error codes (design §5).
//!
//! The number's range tells a client that does not know a code what to do: 100–199 refused, try later;
//! 200–299 refused, don't; 300–399 closed, reconnect; 400–499 closed, stay away.

use std::borrow::Cow;
use std::fmt;

/// The code of an error: a word for people and programs, and a number whose range says what to do.
///
/// ```
/// use mom_proto::Code;
/// assert_eq!(Code::HELD.word(), "held");
/// assert!(Code::HELD.may_retry());
/// assert!(Code::SLOW_RECEIVER.closes());
/// ```
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Code {
    number: u16,
    word: Cow<'static, str>,
}

impl Code {
    /// Too much is going on; the same request may pass later.
    pub const TRY_LATER: Code = Code::new(100, "try-later");
    /// The token has an owner whom this request cannot displace.
    pub const HELD: Code = Code::new(101, "held");
    /// Nothing answered in time.
    pub const TIMED_OUT: Code = Code::new(102, "timed-out");
    /// A bound of the hub (contexts, peers, members) is reached.
    pub const FULL: Code = Code::new(103, "full");
    /// The peer that was asked declined.
    pub const DECLINED: Code = Code::new(104, "declined");
    /// The request was taken back while it waited.
    pub const WITHDRAWN: Code = Code::new(105, "withdrawn");
    /// More than the peer's share of parcels or bytes.
    pub const OVER_QUOTA: Code = Code::new(106, "over-quota");
    /// What must be durable first could not be stored.
    pub const STORAGE_FAILED: Code = Code::new(107, "storage-failed");
    /// What waits of this user is more than of any other, and the hub has no memory for more.
    pub const OVER_MEMORY: Code = Code::new(108, "over-memory");
    /// Another device obeys in that channel, and the channel has one at most.
    pub const OCCUPIED: Code = Code::new(109, "occupied");

    /// A manager refused the request.
    pub const DENIED: Code = Code::new(200, "denied");
    /// The login has no such user or another password.
    pub const BAD_LOGIN: Code = Code::new(201, "bad-login");
    /// This needs a login first.
    pub const NOT_LOGGED_IN: Code = Code::new(202, "not-logged-in");
    /// This needs membership of the context, or of its parent.
    pub const NOT_MEMBER: Code = Code::new(203, "not-member");
    /// This needs ownership of the token.
    pub const NOT_OWNER: Code = Code::new(204, "not-owner");
    /// The fence named is lower than the token's: it was lost in between.
    pub const OLDER_FENCE: Code = Code::new(205, "older-fence");
    /// The fence named was never issued.
    pub const BAD_FENCE: Code = Code::new(206, "bad-fence");
    /// The parcel has expired.
    pub const EXPIRED: Code = Code::new(207, "expired");
    /// The device has moved since the state that the command was based on (M35).
    pub const STALE_STATE: Code = Code::new(208, "stale-state");
    /// What a resume has asked for cannot be resumed: log in and join anew.
    pub const NOT_RESUMED: Code = Code::new(209, "not-resumed");
    /// No context has this path.
    pub const UNKNOWN_PATH: Code = Code::new(210, "unknown-path");
    /// No peer has this name here.
    pub const UNKNOWN_PEER: Code = Code::new(211, "unknown-peer");
    /// No verb has this family and name.
    pub const UNKNOWN_VERB: Code = Code::new(212, "unknown-verb");
    /// No manager has this name or kind.
    pub const UNKNOWN_MANAGER: Code = Code::new(213, "unknown-manager");
    /// The path to be made is taken.
    pub const EXISTS: Code = Code::new(214, "exists");
    /// The context is of a kind that does not know this verb.
    pub const WRONG_KIND: Code = Code::new(215, "wrong-kind");
    /// The context belongs to the configuration file and stays.
    pub const PERMANENT: Code = Code::new(216, "permanent");
    /// There is no such offer or request to answer, or it has ended.
    pub const NO_OFFER: Code = Code::new(217, "no-offer");
    /// The question was answered, has timed out or was never put to this peer.
    pub const TOO_LATE: Code = Code::new(218, "too-late");
    /// Nothing is recorded that could be decided again.
    pub const NOT_RECORDED: Code = Code::new(219, "not-recorded");
    /// A slot is missing, has another type or a value outside its range.
    pub const BAD_SLOT: Code = Code::new(220, "bad-slot");
    /// A path that is not in canonical form.
    pub const BAD_PATH: Code = Code::new(221, "bad-path");
    /// A peer, user or message name that is not allowed.
    pub const BAD_NAME: Code = Code::new(222, "bad-name");
    /// Content that is not what the verb or its codec asks for.
    pub const BAD_CONTENT: Code = Code::new(223, "bad-content");
    /// Text that is not UTF-8 of XML 1.0 characters.
    pub const BAD_ENCODING: Code = Code::new(224, "bad-encoding");
    /// XML outside the grammar of parcels.
    pub const BAD_XML: Code = Code::new(225, "bad-xml");
    /// A multipart body that breaks its own rules.
    pub const BAD_MIME: Code = Code::new(226, "bad-mime");
    /// A `cid` without its part, used twice, or a part without its `cid`.
    pub const BAD_CID: Code = Code::new(227, "bad-cid");
    /// Nested deeper than the limit.
    pub const TOO_DEEP: Code = Code::new(228, "too-deep");
    /// A value that has no form on the wire.
    pub const NOT_ENCODABLE: Code = Code::new(229, "not-encodable");
    /// The slots of a parcel, or the content of one that is not a message, are larger than their limit.
    pub const TOO_LONG: Code = Code::new(230, "too-long");
    /// A line that is not JSON.
    pub const BAD_JSON: Code = Code::new(231, "bad-json");
    /// An `unstop` names an older stop than the one that holds.
    pub const NEWER_STOP: Code = Code::new(232, "newer-stop");

    /// The hub is shutting down.
    pub const SHUTDOWN: Code = Code::new(300, "shutdown");
    /// The receiver's outbox is full of parcels that may not be dropped.
    pub const SLOW_RECEIVER: Code = Code::new(301, "slow-receiver");
    /// Nothing was received for longer than the limit.
    pub const SILENT: Code = Code::new(302, "silent");
    /// No login came within the limit.
    pub const LOGIN_TIMEOUT: Code = Code::new(303, "login-timeout");
    /// More connections than the limit.
    pub const TOO_MANY_CONNECTIONS: Code = Code::new(304, "too-many-connections");
    /// The connection to the hub is lost.
    pub const DISCONNECTED: Code = Code::new(305, "disconnected");
    /// What waited of this user was more than of any other, and the hub had no memory for it.
    pub const OUT_OF_MEMORY: Code = Code::new(306, "out-of-memory");

    /// Bytes that are no frame of the form spoken here.
    pub const BAD_FRAME: Code = Code::new(400, "bad-frame");
    /// A protocol version that the hub does not speak.
    pub const BAD_VERSION: Code = Code::new(401, "bad-version");
    /// XML constructs that are never allowed: a DTD, a processing instruction.
    pub const RESTRICTED_XML: Code = Code::new(402, "restricted-xml");
    /// A parcel or header larger than the limit.
    pub const TOO_LARGE: Code = Code::new(403, "too-large");
    /// A password in plain over a link that others may hear.
    pub const INSECURE: Code = Code::new(404, "insecure");
    /// Too many failed logins on one connection.
    pub const TOO_MANY_LOGINS: Code = Code::new(405, "too-many-logins");
    /// The user was removed, or its rights to be here were.
    pub const REVOKED: Code = Code::new(406, "revoked");
    /// A form, or TLS, that the listener does not take.
    pub const NOT_TAKEN: Code = Code::new(407, "not-taken");
    /// A count of parcels that cannot be: the two ends of a link do not agree on what was said.
    pub const BAD_COUNT: Code = Code::new(408, "bad-count");
    /// The link was resumed over another connection.
    pub const TAKEN_OVER: Code = Code::new(409, "taken-over");

    /// Every code, in the order of its number.
    pub const TABLE: &[Code] = &[
        Code::TRY_LATER,
        Code::HELD,
        Code::TIMED_OUT,
        Code::FULL,
        Code::DECLINED,
        Code::WITHDRAWN,
        Code::OVER_QUOTA,
        Code::STORAGE_FAILED,
        Code::OVER_MEMORY,
        Code::OCCUPIED,
        Code::DENIED,
        Code::BAD_LOGIN,
        Code::NOT_LOGGED_IN,
        Code::NOT_MEMBER,
        Code::NOT_OWNER,
        Code::OLDER_FENCE,
        Code::BAD_FENCE,
        Code::EXPIRED,
        Code::STALE_STATE,
        Code::NOT_RESUMED,
        Code::UNKNOWN_PATH,
        Code::UNKNOWN_PEER,
        Code::UNKNOWN_VERB,
        Code::UNKNOWN_MANAGER,
        Code::EXISTS,
        Code::WRONG_KIND,
        Code::PERMANENT,
        Code::NO_OFFER,
        Code::TOO_LATE,
        Code::NOT_RECORDED,
        Code::BAD_SLOT,
        Code::BAD_PATH,
        Code::BAD_NAME,
        Code::BAD_CONTENT,
        Code::BAD_ENCODING,
        Code::BAD_XML,
        Code::BAD_MIME,
        Code::BAD_CID,
        Code::TOO_DEEP,
        Code::NOT_ENCODABLE,
        Code::TOO_LONG,
        Code::BAD_JSON,
        Code::NEWER_STOP,
        Code::SHUTDOWN,
        Code::SLOW_RECEIVER,
        Code::SILENT,
        Code::LOGIN_TIMEOUT,
        Code::TOO_MANY_CONNECTIONS,
        Code::DISCONNECTED,
        Code::OUT_OF_MEMORY,
        Code::BAD_FRAME,
        Code::BAD_VERSION,
        Code::RESTRICTED_XML,
        Code::TOO_LARGE,
        Code::INSECURE,
        Code::TOO_MANY_LOGINS,
        Code::REVOKED,
        Code::NOT_TAKEN,
        Code::BAD_COUNT,
        Code::TAKEN_OVER,
    ];

    const fn new(number: u16, word: &'static str) -> Code {
        Code {
            number,
            word: Cow::Borrowed(word),
        }
    }

    /// The code of an error parcel: ours, or one that a newer hub knows.
    pub fn from_wire(number: u16, word: &str) -> Code {
        Code::TABLE
            .iter()
            .find(|code| code.number == number && code.word == word)
            .cloned()
            .unwrap_or_else(|| Code {
                number,
                word: Cow::Owned(word.to_owned()),
            })
    }

    /// The number on the wire, unique in the table.
    pub fn number(&self) -> u16 {
        self.number
    }

    /// The word on the wire: the error parcel's `name`.
    pub fn word(&self) -> &str {
        &self.word
    }

    /// Whether the same request may pass later on this connection.
    pub fn may_retry(&self) -> bool {
        (100..200).contains(&self.number)
    }

    /// Whether the hub closes the connection after this error.
    pub fn closes(&self) -> bool {
        self.number >= 300
    }

    /// Whether a client may connect again after this error closed its connection.
    pub fn may_reconnect(&self) -> bool {
        (300..400).contains(&self.number)
    }
}

impl fmt::Display for Code {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.word)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_is_sorted_and_unique() {
        for pair in Code::TABLE.windows(2) {
            assert!(pair[0].number < pair[1].number, "{} before {}", pair[0], pair[1]);
        }
        for (position, code) in Code::TABLE.iter().enumerate() {
            assert!((100..500).contains(&code.number), "{code}");
            assert!(
                Code::TABLE[..position]
                    .iter()
                    .all(|other| other.word != code.word),
                "{code} twice"
            );
        }
    }

    #[test]
    fn an_unknown_code_keeps_its_range() {
        let code = Code::from_wire(199, "from-the-future");
        assert!(code.may_retry() && !code.closes());
        assert_eq!(Code::from_wire(101, "held"), Code::HELD);
    }
}
