//! Bars in groups, on a logarithmic scale: rates and delays differ by powers of ten.

use crate::axis::Axis;
use crate::page::{HEIGHT, LEFT, Page, TOP, WIDTH, escape};

/// Space below the bars, for the names of groups and bars.
const BOTTOM: f64 = 80.0;

/// One bar.
#[derive(Clone, Debug)]
pub struct Bar<'a> {
    /// What it stands for; the same name in every group.
    pub name: &'a str,
    /// Its colour, the same one in every group.
    pub colour: &'a str,
    /// Its length; none is drawn for what is not above 0.
    pub value: f64,
}

/// Bars side by side.
#[derive(Clone, Debug)]
pub struct Group<'a> {
    /// Stands below them, in a line for each part between `, `.
    pub name: &'a str,
    /// The bars.
    pub bars: Vec<Bar<'a>>,
}

/// Groups of bars over a logarithmic axis.
#[derive(Clone, Debug)]
pub struct Bars<'a> {
    /// The title.
    pub title: &'a str,
    /// From left to right.
    pub groups: Vec<Group<'a>>,
}

impl Bars<'_> {
    /// The file, with numbers as `show` writes them. None without a bar.
    pub fn to_svg(&self, show: impl Fn(f64) -> String) -> Option<String> {
        let drawn = |group: &Group<'_>| group.bars.iter().filter(|bar| bar.value > 0.0).count();
        let most = self.groups.iter().map(drawn).max().filter(|most| *most > 0)?;
        let values = self
            .groups
            .iter()
            .flat_map(|group| &group.bars)
            .map(|bar| bar.value);
        let axis = Axis::log("").over(values);
        let mut page = Page::new(self.title, TOP + HEIGHT + BOTTOM);
        for tick in &axis.ticks {
            let y = axis.y(*tick);
            page.put(format_args!(
                "<line class=\"grid\" x1=\"{LEFT}\" y1=\"{y:.1}\" x2=\"{WIDTH}\" y2=\"{y:.1}\"/>"
            ));
            page.text(LEFT - 6.0, y + 4.0, "end", &show(*tick));
        }
        let wide = (WIDTH - LEFT) / self.groups.len() as f64;
        let bar_width = wide * 0.85 / most as f64;
        let mut names: Vec<(&str, &str)> = Vec::new();
        for (number, group) in self.groups.iter().enumerate() {
            let left = LEFT + wide * number as f64;
            for (place, bar) in group.bars.iter().filter(|bar| bar.value > 0.0).enumerate() {
                if !names.contains(&(bar.name, bar.colour)) {
                    names.push((bar.name, bar.colour));
                }
                let y = axis.y(bar.value);
                page.put(format_args!(
                    "<rect x=\"{:.1}\" y=\"{y:.1}\" width=\"{:.1}\" height=\"{:.1}\" fill=\"{}\"><title>{}: {}</title></rect>",
                    left + bar_width * place as f64,
                    bar_width * 0.92,
                    TOP + HEIGHT - y,
                    escape(bar.colour),
                    escape(bar.name),
                    escape(&show(bar.value)),
                ));
            }
            // One line for each part of the name, so that neighbours do not meet.
            for (line, part) in group.name.split(", ").enumerate() {
                let y = TOP + HEIGHT + 16.0 + 12.0 * line as f64;
                page.text(left + wide * 0.42, y, "middle", part);
            }
        }
        page.legend(TOP + HEIGHT + 58.0, names.into_iter());
        Some(page.end())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bars_end_where_their_values_are() {
        let bar = |name, value| Bar {
            name,
            colour: "#0072b2",
            value,
        };
        let bars = Bars {
            title: "rates",
            groups: vec![
                Group {
                    name: "one, there",
                    bars: vec![bar("a", 1e6), bar("b", 1e5)],
                },
                Group {
                    name: "two",
                    bars: vec![bar("a", 0.0)],
                },
            ],
        };
        let svg = bars.to_svg(|value| format!("{value}")).unwrap();
        assert!(svg.contains(&format!("y=\"{TOP:.1}\" width")), "{svg}");
        assert!(
            svg.contains(&format!(
                "height=\"{HEIGHT:.1}\" fill=\"#0072b2\"><title>a: 1000000</title>"
            )),
            "{svg}"
        );
        assert_eq!(svg.matches("<title>").count(), 2, "{svg}");
        assert!(
            svg.contains(">one</text>") && svg.contains(">there</text>"),
            "{svg}"
        );
        assert!(
            Bars {
                groups: Vec::new(),
                ..bars
            }
            .to_svg(|_| String::new())
            .is_none()
        );
    }
}
