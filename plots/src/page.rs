//! The page below every plot: its size, its ground, and text that cannot break the file.

use std::fmt::{Display, Write as _};

/// The width of every plot, in the units of the file.
pub(crate) const WIDTH: f64 = 900.0;
/// Space to the left of what is drawn, for the labels of the axis.
pub(crate) const LEFT: f64 = 76.0;
/// Space above it, for the title.
pub(crate) const TOP: f64 = 60.0;
/// The height of what is drawn.
pub(crate) const HEIGHT: f64 = 320.0;

/// Colours that are told apart on light and on dark ground, also by the colour-blind (Okabe and Ito).
const COLOURS: [&str; 7] = [
    "#0083cc", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#c1272d",
];

/// The wide of a letter, about: for what stands beside text.
const LETTER: f64 = 6.2;

/// An SVG file that is being written.
pub(crate) struct Page {
    text: String,
}

impl Page {
    /// A page of this height with a title.
    pub(crate) fn new(title: &str, height: f64) -> Page {
        let text = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {height}\" font-family=\"sans-serif\" \
             font-size=\"11\">\n<style>\n\
             .ground {{ fill: #ffffff }} text {{ fill: #1f2328 }} .grid {{ stroke: #dddddd }} .mark {{ stroke: #57606a }}\n\
             @media (prefers-color-scheme: dark) {{\n\
             .ground {{ fill: #0d1117 }} text {{ fill: #e6edf3 }} .grid {{ stroke: #30363d }} .mark {{ stroke: #9198a1 }}\n\
             }}\n</style>\n<rect class=\"ground\" width=\"100%\" height=\"100%\"/>\n"
        );
        let mut page = Page { text };
        page.put(format_args!(
            "<text x=\"{LEFT}\" y=\"24\" font-size=\"15\">{}</text>",
            escape(title)
        ));
        page
    }

    /// Adds an element.
    pub(crate) fn put(&mut self, element: impl Display) {
        // Writing to a String cannot fail.
        let _ = writeln!(self.text, "{element}");
    }

    /// Text at a place: `anchor` is `start`, `middle` or `end`.
    pub(crate) fn text(&mut self, x: f64, y: f64, anchor: &str, text: &str) {
        self.put(format_args!(
            "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\">{}</text>",
            escape(text)
        ));
    }

    /// The names of what is drawn with their colours, in as many lines as they need.
    pub(crate) fn legend<'a>(&mut self, top: f64, names: impl Iterator<Item = (&'a str, &'a str)>) {
        let (mut x, mut y) = (LEFT, top);
        for (name, colour) in names {
            let wide = 34.0 + width(name);
            if x > LEFT && x + wide > WIDTH {
                (x, y) = (LEFT, y + LINE);
            }
            self.put(format_args!(
                "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"11\" height=\"11\" fill=\"{}\"/>",
                escape(colour)
            ));
            self.text(x + 16.0, y + 10.0, "start", name);
            x += wide;
        }
    }

    /// The file.
    pub(crate) fn end(self) -> String {
        self.text + "</svg>\n"
    }
}

/// The height of a line of a legend.
pub(crate) const LINE: f64 = 16.0;

/// The lines that the legend of these names needs.
pub(crate) fn legend_lines<'a>(names: impl Iterator<Item = &'a str>) -> f64 {
    let mut lines = 1.0;
    let mut x = LEFT;
    for name in names {
        let wide = 34.0 + width(name);
        if x > LEFT && x + wide > WIDTH {
            (x, lines) = (LEFT, lines + 1.0);
        }
        x += wide;
    }
    lines
}

/// About how wide text is.
pub(crate) fn width(text: &str) -> f64 {
    text.chars().count() as f64 * LETTER
}

/// The colour of the series of this number.
pub(crate) fn colour(number: usize) -> &'static str {
    COLOURS[number % COLOURS.len()]
}

/// Text as it stands in a file.
pub(crate) fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            c if c.is_control() => escaped.push(' '),
            c => escaped.push(c),
        }
    }
    escaped
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_cannot_break_the_file() {
        let mut page = Page::new("<b> & \"c\"", 10.0);
        page.legend(0.0, [("</svg>", "red\" x=\"")].into_iter());
        let file = page.end();
        assert!(file.contains("&lt;b&gt; &amp; &quot;c&quot;"), "{file}");
        assert_eq!(file.matches("</svg>").count(), 1, "{file}");
        assert!(!file.contains("red\" x"), "{file}");
    }

    #[test]
    fn a_legend_that_is_too_wide_goes_on_in_the_next_line() {
        let names = ["a name of some length that fills a part"; 5];
        assert_eq!(legend_lines(names.into_iter()), 3.0);
        assert_eq!(legend_lines(["a", "b"].into_iter()), 1.0);
    }
}
