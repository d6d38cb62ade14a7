//! Which known word was probably meant by an unknown one, for errors that suggest it.

/// Longer words are not compared, bytes: the cost grows with the square of the length, and others may wait for the answer.
const LONGEST: usize = 64;
/// Only so many candidates are compared.
const CANDIDATES: usize = 128;

/// The candidate that is similar enough to `word` to be meant: at most a third of its letters differ, or one.
///
/// None for a word of more than 64 bytes. Candidates of more than 64 bytes, and those behind the 128th, are not compared.
///
/// ```
/// use mom_nearest::nearest;
/// assert_eq!(nearest("grib", ["grab", "give", "renew"]), Some("grab"));
/// assert_eq!(nearest("xyzzy", ["grab", "give"]), None);
/// ```
pub fn nearest<'a>(word: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    if word.len() > LONGEST {
        return None;
    }
    let allowed = (word.chars().count() / 3).max(1);
    let (distance, candidate) = closest(word, candidates)?;
    (distance <= allowed).then_some(candidate)
}

/// The most similar candidate, however little it is like `word`: where there are few words, one of them was meant.
///
/// Of a longer word the first 64 characters count. Candidates are bounded as in [`nearest`].
pub fn most_similar<'a>(word: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let end = word
        .char_indices()
        .nth(LONGEST)
        .map_or(word.len(), |(end, _)| end);
    closest(&word[..end], candidates).map(|(_, candidate)| candidate)
}

fn closest<'a>(word: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<(usize, &'a str)> {
    candidates
        .into_iter()
        .take(CANDIDATES)
        .filter(|candidate| candidate.len() <= LONGEST)
        .map(|candidate| (strsim::osa_distance(word, candidate), candidate))
        .min_by_key(|&(distance, _)| distance)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_swap_is_one_change_and_short_words_may_have_one() {
        assert_eq!(nearest("rde", ["green", "red"]), Some("red"));
        assert_eq!(nearest("x", ["y"]), Some("y"));
        assert_eq!(nearest("ab", ["yz"]), None);
        assert_eq!(most_similar("ab", ["xyz", "yz"]), Some("yz"));
        assert_eq!(most_similar("ab", []), None);
    }

    #[test]
    fn the_cost_is_bounded() {
        let long = "m".repeat(LONGEST + 1);
        assert_eq!(nearest(&long, ["m"]), None);
        assert_eq!(most_similar(&long, ["m", "n"]), Some("m"));
        assert_eq!(nearest(&long[1..], [&long[..], &long[1..]]), Some(&long[1..]));
        let many = std::iter::repeat_n("zzzz", CANDIDATES);
        assert_eq!(nearest("grab", many.clone().chain(["grab"])), None);
        assert_eq!(nearest("grab", many.skip(1).chain(["grab"])), Some("grab"));
    }
}
