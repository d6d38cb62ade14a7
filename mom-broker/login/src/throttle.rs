//! How often logins may fail, per address and per account (threat 15).
//!
//! Of each key one time is kept, up to which its failures are paid back. Unlike a ready-made limiter this one can be
//! asked without being charged, because only failures count and they are known afterwards; and it forgets what it has
//! no room for, because keys come from attackers.

use std::collections::HashMap;
use std::hash::{BuildHasher, Hash, RandomState};
use std::net::{IpAddr, Ipv6Addr};
use std::time::Duration;

use mom_proto::{Gcra, Micros, Pace, Wait};
use parking_lot::Mutex;

use crate::{FailureRate, ThrottleConfig};

/// Addresses, accounts and pairs of both that are remembered; each takes 16 bytes.
const ROOM: usize = 16 * 1024;

const MINUTE: Micros = 60_000_000;

/// The address and the target account of an attempt; hashed, so that all keys have one size.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct AttemptSource {
    address: u64,
    account: Option<Attempted>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Attempted {
    account: u64,
    pair: u64,
    /// Whether it has logged in from there before.
    known: bool,
}

/// Recent failures.
#[derive(Debug)]
pub(super) struct Throttle {
    keys: RandomState,
    state: Mutex<ThrottleState>,
}

#[derive(Debug)]
struct ThrottleState {
    addresses: Table,
    accounts: Table,
    /// Failures from an address that is known to the account, counted separately: neither attacks on the account from
    /// elsewhere nor attacks on others from there hinder the right user.
    pairs: Table,
}

impl Throttle {
    pub(super) fn new() -> Throttle {
        Throttle::with_room(ROOM)
    }

    fn with_room(room: usize) -> Throttle {
        let table = || Table {
            times: HashMap::new(),
            room,
        };
        let state = ThrottleState {
            addresses: table(),
            accounts: table(),
            pairs: table(),
        };
        Throttle {
            keys: RandomState::new(),
            state: Mutex::new(state),
        }
    }

    /// The source of an attempt. A proof that cannot be guessed names no account, so nobody can lock out its owner.
    /// `known` says whether the account has logged in from there before.
    pub(super) fn source(&self, from: IpAddr, account: Option<&str>, known: bool) -> AttemptSource {
        let from = network(from);
        AttemptSource {
            address: self.key(from),
            account: account.map(|account| Attempted {
                account: self.key(account),
                pair: self.key((from, account)),
                known,
            }),
        }
    }

    fn key(&self, of: impl Hash) -> u64 {
        self.keys.hash_one(of)
    }

    /// Whether an attempt may be made now.
    ///
    /// # Errors
    /// The time to wait.
    pub(super) fn check(
        &self,
        source: AttemptSource,
        now: Micros,
        config: &ThrottleConfig,
    ) -> Result<(), Duration> {
        let state = self.state.lock();
        let wait = match source.account {
            Some(account) if account.known => state.pairs.wait(account.pair, now, config.per_place),
            account => {
                let address = state.addresses.wait(source.address, now, config.per_address);
                let account =
                    account.and_then(|account| state.accounts.wait(account.account, now, config.per_account));
                address.max(account)
            }
        };
        wait.map_or(Ok(()), |wait| Err(Duration::from_micros(wait)))
    }

    /// Counts a failure.
    pub(super) fn fail(&self, source: AttemptSource, now: Micros, config: &ThrottleConfig) {
        let mut state = self.state.lock();
        match source.account {
            Some(account) if account.known => {
                state.pairs.charge(account.pair, now, config.per_place);
            }
            account => {
                state.addresses.charge(source.address, now, config.per_address);
                if let Some(account) = account {
                    state.accounts.charge(account.account, now, config.per_account);
                }
            }
        }
    }
}

/// The part that counts as one address: an IPv6 host has 2⁶⁴ of them.
pub fn network(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V6(address) => IpAddr::V6(Ipv6Addr::from_bits(address.to_bits() >> 64 << 64)),
        address @ IpAddr::V4(_) => address,
    }
}

/// Times by key, of bounded number.
#[derive(Debug)]
struct Table {
    times: HashMap<u64, Micros>,
    room: usize,
}

impl Table {
    /// How long until one more failure fits; none if one does now.
    fn wait(&self, key: u64, now: Micros, rate: FailureRate) -> Option<Micros> {
        let used = Gcra::paid_at(*self.times.get(&key)?);
        match used.peek(&pace(rate), 1, now) {
            Ok(()) => None,
            Err(Wait::For(wait)) => Some(wait),
            // A burst of 0, which no configuration has.
            Err(Wait::Never) => Some(MINUTE),
        }
    }

    fn charge(&mut self, key: u64, now: Micros, rate: FailureRate) {
        let mut used = Gcra::paid_at(self.times.get(&key).copied().unwrap_or_default());
        used.charge(&pace(rate), 1, now);
        self.set(key, used.next(&pace(rate)));
    }

    fn set(&mut self, key: u64, time: Micros) {
        if self.times.len() >= self.room && !self.times.contains_key(&key) {
            self.make_room();
        }
        self.times.insert(key, time);
    }

    /// Evicts an eighth: the oldest times, which belong to accounts with the fewest failures and addresses not seen
    /// for longest. Accounts under attack stay.
    fn make_room(&mut self) {
        let mut times: Vec<Micros> = self.times.values().copied().collect();
        let (_, limit, _) = times.select_nth_unstable(self.room / 8);
        let limit = *limit;
        let mut surplus = self.room / 8 + 1;
        self.times.retain(|_, time| {
            let goes = *time <= limit && surplus > 0;
            surplus -= usize::from(goes);
            !goes
        });
    }
}

fn pace(rate: FailureRate) -> Pace {
    Pace::every(MINUTE / u64::from(rate.per_minute.max(1)), rate.burst.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    const CONFIG: ThrottleConfig = ThrottleConfig {
        per_address: FailureRate {
            per_minute: 60,
            burst: 3,
        },
        per_account: FailureRate {
            per_minute: 6,
            burst: 5,
        },
        per_place: FailureRate {
            per_minute: 6,
            burst: 7,
        },
    };

    fn address(number: u32) -> IpAddr {
        IpAddr::from((0x7f00_0000 + number).to_be_bytes())
    }

    /// How many attempts in a row may fail before the source is told to wait, and how long.
    fn fail_all(throttle: &Throttle, source: AttemptSource, now: Micros) -> (usize, Duration) {
        for count in 0.. {
            if let Err(wait) = throttle.check(source, now, &CONFIG) {
                return (count, wait);
            }
            throttle.fail(source, now, &CONFIG);
        }
        unreachable!("every burst ends")
    }

    #[test]
    fn one_address_is_slowed_and_pays_off() {
        let throttle = Throttle::new();
        let source = throttle.source(address(1), Some("alice"), false);
        assert_eq!(fail_all(&throttle, source, 0), (3, Duration::from_secs(1)));
        assert!(throttle.check(source, 999_999, &CONFIG).is_err());
        assert_eq!(
            fail_all(&throttle, source, 1_000_000),
            (1, Duration::from_secs(1))
        );
        let other = throttle.source(address(2), Some("bob"), false);
        assert!(
            throttle.check(other, 0, &CONFIG).is_ok(),
            "others are not concerned"
        );
        assert_eq!(
            fail_all(&throttle, source, 60_000_000).0,
            3,
            "after a while all is forgotten"
        );
    }

    #[test]
    fn an_account_is_slowed_from_everywhere_but_where_it_is_known() {
        let throttle = Throttle::new();
        let home = throttle.source(address(1), Some("alice"), true);
        let mut failed = 0;
        for number in 100..1100 {
            failed += fail_all(
                &throttle,
                throttle.source(address(number), Some("alice"), false),
                0,
            )
            .0;
        }
        assert_eq!(failed, 5, "the account's burst, from all together");
        assert!(throttle.check(home, 0, &CONFIG).is_ok());
        let elsewhere = throttle.source(address(2), Some("alice"), false);
        assert_eq!(
            throttle.check(elsewhere, 0, &CONFIG),
            Err(Duration::from_secs(10)),
            "delayed, not locked out"
        );
        assert!(throttle.check(elsewhere, 10_000_000, &CONFIG).is_ok());
    }

    /// An attacker beside the right user hinders only itself.
    #[test]
    fn a_known_address_is_no_licence() {
        let throttle = Throttle::new();
        let home = throttle.source(address(1), Some("alice"), true);
        fail_all(&throttle, throttle.source(address(1), Some("bob"), false), 0);
        assert!(throttle.check(home, 0, &CONFIG).is_ok());
        assert_eq!(fail_all(&throttle, home, 0).0, 7, "guessing is slowed there too");
        let elsewhere = throttle.source(address(2), Some("alice"), false);
        assert!(throttle.check(elsewhere, 0, &CONFIG).is_ok());
    }

    #[test]
    fn what_cannot_be_guessed_concerns_no_account() {
        let throttle = Throttle::new();
        let device = throttle.source(address(1), None, false);
        assert_eq!(fail_all(&throttle, device, 0).0, 3);
        assert!(
            throttle
                .check(throttle.source(address(2), None, false), 0, &CONFIG)
                .is_ok()
        );
    }

    #[test]
    fn memory_is_bounded_and_the_attacked_stay() {
        let throttle = Throttle::with_room(64);
        let alice = throttle.source(address(1), Some("alice"), false);
        fail_all(&throttle, alice, 0);
        for number in 0..1000 {
            let name = format!("user-{number}");
            let source = throttle.source(address(2 + number), Some(&name), false);
            throttle.fail(source, 0, &CONFIG);
            throttle.fail(
                throttle.source(address(2 + number), Some(&name), true),
                0,
                &CONFIG,
            );
        }
        assert!(throttle.check(alice, 0, &CONFIG).is_err());
        let state = throttle.state.lock();
        for table in [&state.addresses, &state.accounts, &state.pairs] {
            assert!(table.times.len() <= 64, "{}", table.times.len());
        }
    }

    #[test]
    fn one_network_is_one_address() {
        let throttle = Throttle::new();
        let key = |text: &str| {
            throttle
                .source(text.parse().expect("an address"), None, false)
                .address
        };
        assert_eq!(key("2001:db8:1:2::1"), key("2001:db8:1:2:ffff::9"));
        assert_ne!(key("2001:db8:1:2::1"), key("2001:db8:1:3::1"));
        assert_eq!(key("::ffff:10.0.0.1"), key("10.0.0.1"));
        assert_ne!(key("10.0.0.2"), key("10.0.0.1"));
    }
}
