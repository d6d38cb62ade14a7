//! Ages of what was seen, and which of them are believed.

/// The age that is believed of what is so old, with an error bound like that, over a link with that round trip; all in one unit.
///
/// Nothing comes sooner than half a round trip after it was made. An age below that, a negative one, and one whose error is
/// greater than itself tell nothing but their upper bound, which is at least the round trip.
///
/// ```
/// use mom_drive::believed;
///
/// assert_eq!(believed(500, 20, 100), 520);
/// assert_eq!(believed(0, 22, 100), 100);
/// assert_eq!(believed(-300, 400, 100), 400);
/// assert_eq!(believed(50, 200, 100), 250);
/// ```
#[must_use]
pub fn believed(age: i64, error: i64, round_trip: i64) -> i64 {
    let bound = age.max(0).saturating_add(error.max(0));
    match age <= round_trip / 2 || error > age {
        true => bound.max(round_trip),
        false => bound,
    }
}
