//! Reading scripts by the card of a device, for those who send them.

use std::sync::Arc;

use mom_client::{Card, CardVerb};

use crate::DeviceError;
use crate::call::{Call, check_places, read_statement};
use crate::reading::{ends, wait};
use crate::script::{WAIT, check_length, check_number};
use crate::words::split;

/// What a card says of a script.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Carded {
    /// Whether its first motion says only how far it goes, so that the command needs `based-on` (M35).
    pub relative: bool,
    /// Whether it moves the device.
    pub moves: bool,
}

/// Reads a script as the device of this card would; the device may refuse more, such as what is out of its reach.
///
/// ```
/// use mom_client::{Card, CardArg, CardVerb};
/// use mom_device::check_by_card;
///
/// let go = CardVerb::motion("go", "").args([CardArg::number("x", "mm").within(0.0..=100.0)]);
/// let card = Card::new("cart", "").verbs([go]);
/// assert!(check_by_card(&card, "go 5; wait 100").is_ok_and(|script| script.moves));
/// let error = check_by_card(&card, "go 101").unwrap_err();
/// assert_eq!(error.to_string(), "statement 1: x is 101, `go` takes 0 to 100 mm");
/// ```
///
/// # Errors
///
/// `syntax` with the statement's number and where the mistake begins.
pub fn check_by_card(card: &Card, text: &str) -> Result<Carded, DeviceError> {
    statements(card, text).map_err(|error| error.in_text(text))
}

fn statements(card: &Card, text: &str) -> Result<Carded, DeviceError> {
    check_length(text)?;
    let verbs: Vec<Arc<CardVerb>> = card.verbs.iter().cloned().map(Arc::new).collect();
    let (mut read, mut places) = (Vec::new(), Vec::new());
    for mut words in split(text) {
        let Some(verb) = words.next() else { continue };
        let number = check_number(read.len(), verb.at)?;
        let statement = match verb.text {
            WAIT => wait(&mut words)
                .and_then(|_| ends(verb, &mut words))
                .map(|()| None),
            _ => read_statement(&verbs, verb, &mut words).map(Some),
        };
        read.push(statement.map_err(|error| error.at_statement(number))?);
        places.push(verb.at);
    }
    if read.is_empty() {
        return Err(DeviceError::syntax(0, "the script has no statement"));
    }
    let verbs = || read.iter().map(|call| call.as_ref().map(Call::verb));
    check_places(verbs()).map_err(|(number, text)| {
        let at = places.get(number as usize - 1).copied().unwrap_or_default();
        DeviceError::syntax(at, text).at_statement(number)
    })?;
    let moving = || verbs().flatten().filter(|verb| verb.moves);
    Ok(Carded {
        relative: moving()
            .find(|verb| !verb.in_place)
            .is_some_and(|verb| verb.relative),
        moves: moving().next().is_some(),
    })
}

#[cfg(test)]
mod tests {
    use mom_client::{CardArg, CardType};

    use super::*;

    fn card() -> Card {
        let by = CardVerb {
            relative: true,
            ..CardVerb::motion("by", "")
        };
        let jog = CardVerb {
            velocity: true,
            ..CardVerb::motion("jog", "")
        };
        let follow = CardVerb {
            last: true,
            ..CardVerb::motion("follow", "")
        };
        let grip = CardVerb {
            in_place: true,
            ..CardVerb::motion("grip", "")
        };
        let place = || ["x", "y"].map(|name| CardArg::number(name, "mm").within(-10.0..=10.0));
        Card::new("cart", "").verbs([
            CardVerb::motion("go", "").args(place()),
            CardVerb::motion("via", "").args(place()).repeating(2),
            by.args([CardArg::number("way", "mm")]),
            jog.args([
                CardArg::number("speed", "mm/s"),
                CardArg::whole("ms", "ms").or(200),
            ]),
            follow.args([CardArg::new("leader", CardType::Word)]),
            grip.args([CardArg::one_of("grip", &["open", "close"])]),
            CardVerb::new("play", "").args([CardArg::new("sound", CardType::Attachment)]),
        ])
    }

    #[test]
    fn what_the_card_says_is_read() {
        for (text, relative, moves) in [
            ("go 1 2; wait 5 # there", false, true),
            ("via 1 2 3 4 5 6", false, true),
            ("grip open; by 5; go 1 1", true, true),
            ("go 1 1; by 5", false, true),
            ("jog 5", false, true),
            ("jog 5 100", false, true),
            ("go 1 1; follow ada", false, true),
            ("wait 5; play hello", false, false),
        ] {
            assert_eq!(
                check_by_card(&card(), text),
                Ok(Carded { relative, moves }),
                "{text}"
            );
        }
    }

    #[test]
    fn mistakes_are_told_with_their_place() {
        for (text, column, words) in [
            ("", 1, "the script has no statement"),
            ("og 1 2", 1, "statement 1: there is no `og`; did you mean `go`?"),
            (
                "wait 1; go 1",
                13,
                "statement 2: `go` takes `go x/mm y/mm`; y is missing",
            ),
            ("go 1 y", 6, "statement 1: y is `y`, which is not a number"),
            ("go 1 11", 6, "statement 1: y is 11, `go` takes -10 to 10 mm"),
            (
                "go 1 2 3",
                8,
                "statement 1: `go` ends before `3`; is a `;` or a new line missing?",
            ),
            (
                "via 1 2 3",
                10,
                "statement 1: `via` takes `via x/mm y/mm …`; y is missing",
            ),
            (
                "grip closed",
                6,
                "statement 1: there is no `closed`; did you mean `close`?",
            ),
            (
                "jog 5 1.5",
                7,
                "statement 1: ms is `1.5`, which is not a whole number",
            ),
            (
                "jog 5; wait 1",
                1,
                "statement 1: `jog` stands alone in its script",
            ),
            (
                "wait 1; follow ada; wait 1",
                9,
                "statement 2: `follow` must be the last statement of its script",
            ),
            (
                "wait 60001",
                6,
                "statement 1: `wait` takes a whole number of ms from 0 to 60000, not `60001`",
            ),
        ] {
            let error = check_by_card(&card(), text).expect_err(text);
            assert_eq!(
                (error.to_string(), error.place()),
                (words.to_owned(), Some((1, column))),
                "{text}"
            );
        }
    }
}
