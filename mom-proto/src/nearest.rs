//! Suggestions for errors about unknown names.

/// The candidate most similar to `word`, if it is similar enough to be meant.
///
/// ```
/// use mom_proto::nearest::nearest;
/// assert_eq!(nearest("grib", ["grab", "give", "renew"]), Some("grab"));
/// assert_eq!(nearest("xyzzy", ["grab", "give"]), None);
/// ```
pub fn nearest<'a>(word: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    // The cost grows with the square of the length and with the number of candidates, and it is paid where others
    // wait: long words get no suggestion, and only so many candidates are looked at.
    const LONGEST: usize = 64;
    const CANDIDATES: usize = 128;
    if word.len() > LONGEST {
        return None;
    }
    let allowed = (word.chars().count() / 3).max(1);
    candidates
        .into_iter()
        .take(CANDIDATES)
        .filter(|candidate| candidate.len() <= LONGEST)
        .map(|candidate| (strsim::osa_distance(word, candidate), candidate))
        .filter(|&(distance, _)| distance <= allowed)
        .min_by_key(|&(distance, _)| distance)
        .map(|(_, candidate)| candidate)
}
