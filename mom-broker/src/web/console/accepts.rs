//! What a client takes, by the headers of its request.

use http::HeaderValue;
use http::header::{ACCEPT, ACCEPT_ENCODING, AsHeaderName, HeaderMap, IF_NONE_MATCH};

/// Whether it reads gzip (RFC 9110, 12.5.3): what is not named goes by `*`, and what has the weight 0 is refused.
pub(super) fn takes_gzip(headers: &HeaderMap) -> bool {
    let (mut named, mut any) = (None, false);
    for (coding, taken) in weighted(headers, ACCEPT_ENCODING) {
        match coding.to_ascii_lowercase().as_str() {
            "gzip" | "x-gzip" => named = Some(taken),
            "*" => any = taken,
            _ => {}
        }
    }
    named.unwrap_or(any)
}

/// Whether a page is asked for, as browsers do: a client that accepts anything (`*/*`) is a program, and gets text.
pub(super) fn takes_html(headers: &HeaderMap) -> bool {
    weighted(headers, ACCEPT).any(|(media, taken)| taken && media.eq_ignore_ascii_case("text/html"))
}

/// Whether it has what bears this tag (RFC 9110, 13.1.2).
pub(super) fn has(headers: &HeaderMap, tag: &HeaderValue) -> bool {
    let known = parts(headers, IF_NONE_MATCH);
    known
        .into_iter()
        .any(|known| known == "*" || known.trim_start_matches("W/").as_bytes() == tag.as_bytes())
}

/// The elements of a list with weights: each without its parameters, and whether it is taken.
fn weighted(headers: &HeaderMap, name: impl AsHeaderName) -> impl Iterator<Item = (&str, bool)> {
    parts(headers, name).map(|part| {
        let mut pieces = part.split(';').map(str::trim);
        let what = pieces.next().unwrap_or_default();
        let weight = pieces.filter_map(|piece| piece.split_once('='));
        let refused = |(key, value): (&str, &str)| {
            key.trim().eq_ignore_ascii_case("q")
                && value.trim().parse::<f32>().is_ok_and(|weight| weight <= 0.0)
        };
        (what, !weight.into_iter().any(refused))
    })
}

/// The elements of a list; the tags of files have no commas.
fn parts(headers: &HeaderMap, name: impl AsHeaderName) -> impl Iterator<Item = &str> {
    let lines = headers
        .get_all(name)
        .into_iter()
        .filter_map(|line| line.to_str().ok());
    lines
        .flat_map(|line| line.split(','))
        .map(str::trim)
        .filter(|part| !part.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;
    use http::HeaderName;

    fn with(name: &HeaderName, lines: &[&'static str]) -> HeaderMap {
        let lines = lines
            .iter()
            .map(|line| (name.clone(), HeaderValue::from_static(line)));
        let mut headers = HeaderMap::new();
        for (name, line) in lines {
            headers.append(name, line);
        }
        headers
    }

    #[test]
    fn gzip_is_sent_to_who_takes_it() {
        for (lines, taken) in [
            (&[][..], false),
            (&["gzip, deflate, br"], true),
            (&["br", "gzip;q=0.5"], true),
            (&["GZIP"], true),
            (&["x-gzip"], true),
            (&["*"], true),
            (&["identity"], false),
            (&["gzip;q=0"], false),
            (&["gzip; q=0.000, *"], false),
            (&["*;q=0, gzip"], true),
            (&["br, *;q=0"], false),
            (&["gzipped"], false),
            (&[""], false),
        ] {
            assert_eq!(takes_gzip(&with(&ACCEPT_ENCODING, lines)), taken, "{lines:?}");
        }
    }

    #[test]
    fn pages_are_for_browsers() {
        for (lines, taken) in [
            (&[][..], false),
            (&["*/*"], false),
            (
                &["text/html,application/xhtml+xml,application/xml;q=0.9,*/*;q=0.8"],
                true,
            ),
            (&["text/plain, Text/HTML;q=0.1"], true),
            (&["text/html;q=0, */*"], false),
            (&["application/json"], false),
        ] {
            assert_eq!(takes_html(&with(&ACCEPT, lines)), taken, "{lines:?}");
        }
    }

    #[test]
    fn what_is_known_by_its_tag_is_not_sent_again() {
        for (lines, known) in [
            (&[][..], false),
            (&["\"ab\""], true),
            (&["W/\"ab\""], true),
            (&["\"cd\", \"ab\""], true),
            (&["\"cd\"", "*"], true),
            (&["\"cd\""], false),
            (&["ab"], false),
        ] {
            let tag = HeaderValue::from_static("\"ab\"");
            assert_eq!(has(&with(&IF_NONE_MATCH, lines), &tag), known, "{lines:?}");
        }
    }
}
