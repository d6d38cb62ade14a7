//! Points and lines over two axes.

use std::fmt::Write as _;

use crate::axis::{Axis, Span, plain};
use crate::page::{HEIGHT, LEFT, LINE, Page, TOP, WIDTH, colour, escape, legend_lines, width};

/// What is drawn of a series.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Drawn {
    Points,
    Line,
    Steps,
}

/// Values that belong together.
#[derive(Clone, Debug)]
pub struct Series {
    name: String,
    drawn: Drawn,
    values: Vec<(f64, f64)>,
}

impl Series {
    /// A point for each value.
    pub fn points(name: impl Into<String>, values: Vec<(f64, f64)>) -> Series {
        Series {
            name: name.into(),
            drawn: Drawn::Points,
            values,
        }
    }

    /// A line through the values, in their order.
    pub fn line(name: impl Into<String>, values: Vec<(f64, f64)>) -> Series {
        Series {
            drawn: Drawn::Line,
            ..Series::points(name, values)
        }
    }

    /// A line that rises at each value, as of [`quantiles`](crate::quantiles).
    pub fn steps(name: impl Into<String>, values: Vec<(f64, f64)>) -> Series {
        Series {
            drawn: Drawn::Steps,
            ..Series::points(name, values)
        }
    }
}

/// A number to compare with.
#[derive(Clone, Debug)]
enum Mark {
    X(f64, String),
    Y(f64, String),
}

/// A plot with two axes.
#[derive(Clone, Debug)]
pub struct Plot {
    title: String,
    x: Axis,
    y: Axis,
    series: Vec<Series>,
    marks: Vec<Mark>,
}

impl Plot {
    /// A plot of nothing yet.
    pub fn new(title: impl Into<String>, x: Axis, y: Axis) -> Plot {
        Plot {
            title: title.into(),
            x,
            y,
            series: Vec::new(),
            marks: Vec::new(),
        }
    }

    /// With one more series; each has a colour of its own.
    pub fn with(mut self, series: Series) -> Plot {
        self.series.push(series);
        self
    }

    /// With a labelled line from top to bottom at a value of the x axis.
    pub fn mark_x(mut self, x: f64, label: impl Into<String>) -> Plot {
        self.marks.push(Mark::X(x, label.into()));
        self
    }

    /// With a labelled line from left to right at a value of the y axis.
    pub fn mark_y(mut self, y: f64, label: impl Into<String>) -> Plot {
        self.marks.push(Mark::Y(y, label.into()));
        self
    }

    /// The file.
    pub fn to_svg(&self) -> String {
        let values = || self.series.iter().flat_map(|series| &series.values);
        let marked = |wanted: fn(&Mark) -> Option<f64>| self.marks.iter().filter_map(wanted);
        let x = self.x.over(values().map(|(x, _)| *x).chain(marked(Mark::x)));
        let y = self.y.over(values().map(|(_, y)| *y).chain(marked(Mark::y)));
        let names = || self.series.iter().map(|series| series.name.as_str());
        let legend = TOP + HEIGHT + 46.0;
        let mut page = Page::new(&self.title, legend + LINE * legend_lines(names()) + 4.0);
        self.axes(&mut page, &x, &y);
        for (number, series) in self.series.iter().enumerate() {
            self.draw(&mut page, series, colour(number), &x, &y);
        }
        self.marks(&mut page, &x, &y);
        page.legend(
            legend,
            names().enumerate().map(|(number, name)| (name, colour(number))),
        );
        page.end()
    }

    fn axes(&self, page: &mut Page, x: &Span, y: &Span) {
        let (bottom, right) = (TOP + HEIGHT, WIDTH - 24.0);
        for tick in &y.ticks {
            let at = y.y(*tick);
            page.put(format_args!(
                "<line class=\"grid\" x1=\"{LEFT}\" y1=\"{at:.1}\" x2=\"{right}\" y2=\"{at:.1}\"/>"
            ));
            page.text(LEFT - 6.0, at + 4.0, "end", &plain(*tick));
        }
        for tick in &x.ticks {
            let at = x.x(*tick);
            page.put(format_args!(
                "<line class=\"grid\" x1=\"{at:.1}\" y1=\"{TOP}\" x2=\"{at:.1}\" y2=\"{bottom}\"/>"
            ));
            page.text(at, bottom + 16.0, "middle", &plain(*tick));
        }
        page.text(
            f64::midpoint(LEFT, right),
            bottom + 34.0,
            "middle",
            self.x.label(),
        );
        page.text(LEFT - 6.0, TOP - 12.0, "start", self.y.label());
    }

    fn draw(&self, page: &mut Page, series: &Series, colour: &str, x: &Span, y: &Span) {
        let seen = |(at, value): &&(f64, f64)| self.x.takes(*at) && self.y.takes(*value);
        let places = series.values.iter().filter(seen);
        let places: Vec<(f64, f64)> = places.map(|(at, value)| (x.x(*at), y.y(*value))).collect();
        if series.drawn == Drawn::Points {
            for (at, value) in places {
                page.put(format_args!(
                    "<circle cx=\"{at:.1}\" cy=\"{value:.1}\" r=\"2.4\" fill=\"{colour}\" fill-opacity=\"0.6\"/>"
                ));
            }
            return;
        }
        let mut path = String::new();
        for (at, value) in places {
            // Writing to a String cannot fail.
            let _ = match (path.is_empty(), series.drawn) {
                (true, _) => write!(path, "M{at:.1} {value:.1}"),
                (false, Drawn::Steps) => write!(path, "H{at:.1}V{value:.1}"),
                (false, _) => write!(path, "L{at:.1} {value:.1}"),
            };
        }
        page.put(format_args!(
            "<path d=\"{path}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"2\"><title>{}</title></path>",
            escape(&series.name)
        ));
    }

    /// Marks with their labels, each label in a line of its own so that neighbours do not meet.
    fn marks(&self, page: &mut Page, x: &Span, y: &Span) {
        let mut lines = 0.0;
        for mark in &self.marks {
            let (line, label, (at, above, anchor)) = match mark {
                Mark::X(value, label) => {
                    let at = x.x(*value);
                    lines += 1.0;
                    // At the right edge the label stands before its line.
                    let fits = at + 5.0 + width(label) < WIDTH;
                    let place = if fits {
                        (at + 5.0, "start")
                    } else {
                        (at - 5.0, "end")
                    };
                    let line = format!(
                        "x1=\"{at:.1}\" y1=\"{TOP}\" x2=\"{at:.1}\" y2=\"{:.1}\"",
                        TOP + HEIGHT
                    );
                    (line, label, (place.0, TOP + 14.0 * lines, place.1))
                }
                Mark::Y(value, label) => {
                    let (at, right) = (y.y(*value), WIDTH - 24.0);
                    let line = format!("x1=\"{LEFT}\" y1=\"{at:.1}\" x2=\"{right}\" y2=\"{at:.1}\"");
                    (line, label, (LEFT + 6.0, at - 4.0, "start"))
                }
            };
            page.put(format_args!(
                "<line class=\"mark\" {line} stroke-dasharray=\"5 3\"/>"
            ));
            page.text(at, above, anchor, label);
        }
    }
}

impl Mark {
    fn x(&self) -> Option<f64> {
        match self {
            Mark::X(value, _) => Some(*value),
            Mark::Y(..) => None,
        }
    }

    fn y(&self) -> Option<f64> {
        match self {
            Mark::Y(value, _) => Some(*value),
            Mark::X(..) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plot() -> Plot {
        Plot::new("round trips", Axis::log("bytes"), Axis::linear("ms"))
            .with(Series::points("each", vec![(1.0, 1.0), (10.0, 5.0), (0.0, 5.0)]))
            .with(Series::line("p50", vec![(1.0, 0.0), (100.0, 10.0)]))
            .with(Series::steps("share", vec![(1.0, 0.0), (100.0, 10.0)]))
            .mark_x(10.0, "M60 <1000 B")
            .mark_y(5.0, "as the paper")
    }

    #[test]
    fn values_are_where_the_axes_say() {
        let svg = plot().to_svg();
        let (left, right) = (format!("{LEFT:.1}"), "876.0");
        let (top, bottom) = (format!("{TOP:.1}"), format!("{:.1}", TOP + HEIGHT));
        assert!(svg.contains(&format!("M{left} {bottom}L{right} {top}")), "{svg}");
        assert!(svg.contains(&format!("M{left} {bottom}H{right}V{top}")), "{svg}");
        // What a logarithmic axis has no place for is left out.
        assert_eq!(svg.matches("<circle").count(), 2);
        assert!(svg.contains("cx=\"476.0\" cy=\"220.0\""), "{svg}");
    }

    #[test]
    fn marks_and_names_are_told() {
        let svg = plot().to_svg();
        for part in [
            "M60 &lt;1000 B",
            "as the paper",
            ">each<",
            ">p50<",
            ">bytes<",
            ">ms<",
            "dark",
        ] {
            assert!(svg.contains(part), "{part} in {svg}");
        }
        assert_eq!(svg.matches("class=\"mark\"").count(), 2);
        assert!(
            Plot::new("nothing", Axis::log(""), Axis::linear(""))
                .to_svg()
                .ends_with("</svg>\n")
        );
    }
}
