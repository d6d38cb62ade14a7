//! The file of a fleet: which unit number has which address (W14).
//!
//! ```toml
//! [[robot]]
//! unit = 1
//! address = "127.0.0.1:4001"
//!
//! [[robot]]
//! unit = 2
//! name = "the one with the camera"
//! group = "scouts"
//! address = "[fd00::12]:4001"
//! ```

use std::collections::HashMap;
use std::fmt;
use std::net::{IpAddr, Ipv6Addr};
use std::ops::Range;

use mom_toml_faults::{At, Item, Section, Shape, Spot, quoted};

/// The number by which people call a robot (W14): 1 to 99 999.
pub type Unit = u32;

/// The highest unit number.
pub const HIGHEST_UNIT: Unit = 99_999;

/// The most robots of a fleet.
pub const MOST_ROBOTS: usize = 10_000;

/// The most characters of a group's name.
pub const LONGEST_GROUP: usize = 32;

/// What a group is not called, as it means something else where groups and robots are named.
const NO_GROUPS: [&str; 3] = ["all", "status", "token"];

/// The most characters of a robot's name.
pub const LONGEST_NAME: usize = 64;

/// Where a robot listens: a host, by name or address, and a port.
///
/// It is written `host:port`, an IPv6 address in brackets. Two texts of one address are equal.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Address {
    host: String,
    port: u16,
}

impl Address {
    /// The host, without brackets.
    #[must_use]
    pub fn host(&self) -> &str {
        &self.host
    }

    /// The port.
    #[must_use]
    pub const fn port(&self) -> u16 {
        self.port
    }

    /// Reads `host:port`.
    ///
    /// # Errors
    ///
    /// What is wrong with it, in words.
    pub fn parse(text: &str) -> Result<Address, String> {
        let shown = quoted(text);
        let (host, port) = match text.strip_prefix('[') {
            Some(rest) => {
                let Some((host, rest)) = rest.split_once(']') else {
                    return Err(format!("`{shown}` has `[` without `]`"));
                };
                let Ok(address) = host.parse::<Ipv6Addr>() else {
                    return Err(format!(
                        "what is in the brackets of `{shown}` is not an IPv6 address"
                    ));
                };
                (IpAddr::from(address).to_string(), rest.strip_prefix(':'))
            }
            None if text.matches(':').count() > 1 => {
                return Err(format!(
                    "an IPv6 address stands in brackets before its port, as in `[::1]:4001`: `{shown}`"
                ));
            }
            None => match text.split_once(':') {
                Some((host, port)) => (host.to_ascii_lowercase(), Some(port)),
                None => (text.to_ascii_lowercase(), None),
            },
        };
        let Some(port) = port else {
            return Err(format!("the port is missing: `{shown}` should be `{shown}:PORT`"));
        };
        if host.is_empty() || host.chars().any(|c| c.is_whitespace() || c.is_control()) {
            return Err(format!("the host is missing or invalid in `{shown}`"));
        }
        let digits = port.bytes().all(|byte| byte.is_ascii_digit());
        match port.parse() {
            Ok(port) if digits && port > 0 => Ok(Address { host, port }),
            _ => Err(format!("the port of `{shown}` is not a number from 1 to 65535")),
        }
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.host.contains(':') {
            true => write!(f, "[{}]:{}", self.host, self.port),
            false => write!(f, "{}:{}", self.host, self.port),
        }
    }
}

/// One robot of a fleet.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Robot {
    /// Its unit number.
    pub unit: Unit,
    /// Where it listens.
    pub address: Address,
    /// What people call it.
    pub name: Option<String>,
    /// With whom it is driven together.
    pub group: Option<String>,
}

/// The robots of a file, in the order of their unit numbers; at least one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fleet {
    robots: Vec<Robot>,
}

/// What is wrong in a fleet's file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum FleetFault {
    /// It is not TOML.
    Syntax,
    /// Nobody knows this key.
    UnknownKey,
    /// A key is missing.
    MissingKey,
    /// A value is of another type than its key's.
    Type,
    /// A unit number is not between 1 and 99 999.
    Unit,
    /// Two robots have this unit number.
    UnitTwice,
    /// An address is not a `host:port`.
    Address,
    /// Two robots have this address.
    AddressTwice,
    /// A name is empty, too long, or has control characters.
    Name,
    /// A group is not a word of letters, digits, `-` and `_`, or is a number.
    Group,
    /// There is no robot.
    Empty,
    /// There are more than 10 000 robots.
    TooMany,
}

/// What is wrong in a fleet's file, and where.
pub type FleetError = mom_toml_faults::FileError<FleetFault>;

type Found = mom_toml_faults::Found<FleetFault>;

impl From<Shape> for FleetFault {
    fn from(shape: Shape) -> FleetFault {
        match shape {
            Shape::Syntax => FleetFault::Syntax,
            Shape::UnknownKey => FleetFault::UnknownKey,
            Shape::MissingKey => FleetFault::MissingKey,
            Shape::Type => FleetFault::Type,
        }
    }
}

impl Fleet {
    /// Reads a fleet's file.
    ///
    /// ```
    /// use mom_base_station::fleet::Fleet;
    ///
    /// let fleet = Fleet::parse("[[robot]]\nunit = 1\naddress = \"127.0.0.1:4001\"\n")?;
    /// assert_eq!(fleet.robots()[0].address.port(), 4001);
    ///
    /// let error = Fleet::parse("[[robot]]\nunit = 1\nadress = \"127.0.0.1:4001\"\n").unwrap_err();
    /// assert_eq!(error.to_string(), "line 3, column 1: there is no key `adress`; did you mean `address`?");
    /// # Ok::<(), mom_base_station::fleet::FleetError>(())
    /// ```
    ///
    /// # Errors
    ///
    /// The first fault, and its place. Then nothing of the file is taken.
    pub fn parse(text: &str) -> Result<Fleet, FleetError> {
        read(text).map_err(|found| found.at(text))
    }

    /// The robots, by unit number.
    #[must_use]
    pub fn robots(&self) -> &[Robot] {
        &self.robots
    }

    /// The unit numbers, the lowest first.
    #[must_use]
    pub fn units(&self) -> Vec<Unit> {
        self.robots.iter().map(|robot| robot.unit).collect()
    }

    /// The same fleet without the robots that are not asked for; `None` if nothing is left.
    #[must_use]
    pub fn only(&self, units: &[Unit]) -> Option<Fleet> {
        let asked = |robot: &&Robot| units.contains(&robot.unit);
        let robots: Vec<Robot> = self.robots.iter().filter(asked).cloned().collect();
        (!robots.is_empty()).then_some(Fleet { robots })
    }
}

fn read(text: &str) -> Result<Fleet, Found> {
    let root = Section::parse(text)?;
    let listed = root.only(&["robot"])?.tables("robot")?;
    if listed.is_empty() {
        return Err(Found::new(FleetFault::Empty, &(0..0), "there is no `[[robot]]`"));
    }
    if let Some(first) = listed.get(MOST_ROBOTS) {
        let text = format!("{} robots exceed the limit of {MOST_ROBOTS}", listed.len());
        return Err(Found::new(FleetFault::TooMany, &first.span, text));
    }
    let mut robots = Vec::with_capacity(listed.len());
    let mut units = HashMap::new();
    let mut addresses = HashMap::new();
    for keys in listed {
        let (robot, [unit_span, address_span]) = read_robot(keys)?;
        if let Some(start) = units.insert(robot.unit, unit_span.start) {
            let line = Spot::of(text, start).line;
            let text = format!("unit {} is already in line {line}", robot.unit);
            return Err(Found::new(FleetFault::UnitTwice, unit_span, text));
        }
        if let Some(other) = addresses.insert(robot.address.clone(), robot.unit) {
            let text = format!("{} is already the address of unit {other}", robot.address);
            return Err(Found::new(FleetFault::AddressTwice, address_span, text));
        }
        robots.push(robot);
    }
    robots.sort_by_key(|robot| robot.unit);
    Ok(Fleet { robots })
}

/// A robot, and where its unit number and its address are.
fn read_robot(keys: &Section) -> Result<(Robot, [&Range<usize>; 2]), Found> {
    keys.only(&["unit", "address", "name", "group"])?;
    let unit_value = keys.required("unit")?;
    let in_range = |number: &Unit| (1..=HIGHEST_UNIT).contains(number);
    let Some(unit) = Unit::try_from(unit_value.integer()?).ok().filter(in_range) else {
        let text = format!("a unit number is 1 to {HIGHEST_UNIT}");
        return Err(Found::new(FleetFault::Unit, &unit_value.span, text));
    };
    let address_value = keys.required("address")?;
    let address = Address::parse(address_value.text()?)
        .map_err(|text| Found::new(FleetFault::Address, &address_value.span, text))?;
    let robot = Robot {
        unit,
        address,
        name: keys.get("name").map(read_name).transpose()?,
        group: keys.get("group").map(read_group).transpose()?,
    };
    Ok((robot, [&unit_value.span, &address_value.span]))
}

fn read_name(value: &At<Item>) -> Result<String, Found> {
    let name = value.text()?;
    let length = name.chars().count();
    if name.trim().is_empty() || length > LONGEST_NAME || name.chars().any(char::is_control) {
        let text = format!("a name has 1 to {LONGEST_NAME} characters, none of them a control character");
        return Err(Found::new(FleetFault::Name, &value.span, text));
    }
    Ok(name.to_owned())
}

fn read_group(value: &At<Item>) -> Result<String, Found> {
    let group = value.text()?;
    let is_word = (1..=LONGEST_GROUP).contains(&group.len())
        && group
            .bytes()
            .all(|byte| byte.is_ascii_alphanumeric() || b"-_".contains(&byte));
    if is_word && !group.starts_with(|c: char| !c.is_ascii_alphabetic()) && !NO_GROUPS.contains(&group) {
        return Ok(group.to_owned());
    }
    let text = format!(
        "a group is a letter and up to {} letters, digits, `-` and `_` more, and not `all`, `status` or `token`",
        LONGEST_GROUP - 1
    );
    Err(Found::new(FleetFault::Group, &value.span, text))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(text: &str) -> (FleetFault, String) {
        let error = Fleet::parse(text).unwrap_err();
        (error.fault(), error.to_string())
    }

    fn robot(unit: impl fmt::Display, address: &str) -> String {
        format!("[[robot]]\nunit = {unit}\naddress = \"{address}\"\n")
    }

    #[test]
    fn robots_are_read_and_ordered_by_unit() {
        let text = format!(
            "{}{}name = \"left\"\ngroup = \"scouts\"\n",
            robot(7, "Robot.Lab:4001"),
            robot(2, "[::1]:65535")
        );
        let fleet = Fleet::parse(&text).unwrap();
        assert_eq!(fleet.units(), [2, 7]);
        let [two, seven] = fleet.robots() else {
            panic!("two robots")
        };
        assert_eq!((two.address.host(), two.address.port()), ("::1", 65_535));
        assert_eq!(two.address.to_string(), "[::1]:65535");
        assert_eq!(two.name.as_deref(), Some("left"));
        assert_eq!((two.group.as_deref(), &seven.group), (Some("scouts"), &None));
        assert_eq!(seven.address.to_string(), "robot.lab:4001");
        assert_eq!(fleet.only(&[7]).unwrap().units(), [7]);
        assert_eq!(fleet.only(&[1]), None);
    }

    fn check<const N: usize>(cases: [(String, FleetFault, &str); N]) {
        for (text, fault, words) in cases {
            let (found, message) = error(&text);
            assert_eq!(found, fault, "{text}");
            assert!(message.starts_with(words), "{text}: {message}");
        }
    }

    #[test]
    fn each_fault_of_keys_and_units_has_its_place_and_its_code() {
        use FleetFault::*;
        check([
            ("robot = ".to_owned(), Syntax, "line 1, column"),
            (String::new(), Empty, "line 1, column 1: there is no `[[robot]]`"),
            (
                "robot = []".to_owned(),
                Empty,
                "line 1, column 1: there is no `[[robot]]`",
            ),
            (
                "[[robots]]\n".to_owned(),
                UnknownKey,
                "line 1, column 3: there is no key `robots`; did you mean `robot`?",
            ),
            (
                "robot = 1".to_owned(),
                Type,
                "line 1, column 9: expected a list of tables, found an integer: write `[[robot]]`",
            ),
            (
                "robot = [1]".to_owned(),
                Type,
                "line 1, column 10: expected a table, found an integer: write `[[robot]]`",
            ),
            (
                "[[robot]]\nunit = 1\n".to_owned(),
                MissingKey,
                "line 1, column 1: `address` is missing",
            ),
            (
                "[[robot]]\naddress = \"a:1\"\n".to_owned(),
                MissingKey,
                "line 1, column 1: `unit` is missing",
            ),
            (
                robot("\"1\"", "a:1"),
                Type,
                "line 2, column 8: expected an integer, found a text",
            ),
            (
                robot(0, "a:1"),
                Unit,
                "line 2, column 8: a unit number is 1 to 99999",
            ),
            (
                robot(100_000, "a:1"),
                Unit,
                "line 2, column 8: a unit number is 1 to 99999",
            ),
            (
                robot("99999999999999999999", "a:1"),
                Unit,
                "line 2, column 8: a unit number is 1 to 99999",
            ),
            (
                robot(1, "a:1") + &robot(1, "b:1"),
                UnitTwice,
                "line 5, column 8: unit 1 is already in line 2",
            ),
            (
                robot(1, "a:1") + &robot(2, "A:1"),
                AddressTwice,
                "line 6, column 11: a:1 is already the address of unit 1",
            ),
            (
                robot(1, "[::1]:1") + &robot(2, "[0:0::1]:1"),
                AddressTwice,
                "line 6, column 11: [::1]:1 is already the address of unit 1",
            ),
        ]);
    }

    #[test]
    fn each_fault_of_addresses_and_names_has_its_place_and_its_code() {
        use FleetFault::*;
        check([
            (
                robot(1, "10.0.0.1"),
                Address,
                "line 3, column 11: the port is missing: `10.0.0.1` should be `10.0.0.1:PORT`",
            ),
            (
                robot(1, "::1:4001"),
                Address,
                "line 3, column 11: an IPv6 address stands in brackets before its port, as in `[::1]:4001`: `::1:4001`",
            ),
            (
                robot(1, "[::1"),
                Address,
                "line 3, column 11: `[::1` has `[` without `]`",
            ),
            (
                robot(1, "[lab]:1"),
                Address,
                "line 3, column 11: what is in the brackets of `[lab]:1` is not an IPv6 address",
            ),
            (
                robot(1, "[::1]"),
                Address,
                "line 3, column 11: the port is missing: `[::1]` should be `[::1]:PORT`",
            ),
            (
                robot(1, ":1"),
                Address,
                "line 3, column 11: the host is missing or invalid in `:1`",
            ),
            (
                robot(1, "a:0"),
                Address,
                "line 3, column 11: the port of `a:0` is not a number from 1 to 65535",
            ),
            (
                robot(1, "a:+1"),
                Address,
                "line 3, column 11: the port of `a:+1` is not a number from 1 to 65535",
            ),
            (
                robot(1, "a:70000"),
                Address,
                "line 3, column 11: the port of `a:70000` is not a number from 1 to 65535",
            ),
            (
                robot(1, "a:1") + "name = \"\"\n",
                Name,
                "line 4, column 8: a name has 1 to 64 characters, none of them a control character",
            ),
            (
                robot(1, "a:1") + "group = \"7\"\n",
                Group,
                "line 4, column 9: a group is a letter and up to 31 letters, digits, `-` and `_` more",
            ),
            (
                robot(1, "a:1") + "group = \"all\"\n",
                Group,
                "line 4, column 9: a group is a letter",
            ),
            (
                robot(1, "a:1") + "group = \"token\"\n",
                Group,
                "line 4, column 9: a group is a letter",
            ),
        ]);
    }

    #[test]
    fn a_fleet_has_at_most_10_000_robots() {
        let text = |count: u16| -> String {
            (1..=count)
                .map(|unit| robot(unit, &format!("a:{unit}")))
                .collect()
        };
        assert_eq!(Fleet::parse(&text(10_000)).unwrap().robots().len(), 10_000);
        let (fault, message) = error(&text(10_001));
        assert_eq!(fault, FleetFault::TooMany);
        assert!(
            message.starts_with("line 30001, column 1: 10001 robots"),
            "{message}"
        );
    }

    proptest::proptest! {
        #[test]
        fn no_text_makes_it_panic(text in "(\\[\\[robot\\]\\]|unit|address|name|=|[0-9\":\\[\\]\\n a]){0,30}") {
            let result = Fleet::parse(&text);
            proptest::prop_assert!(result.is_err() || !text.is_empty());
        }
    }
}
