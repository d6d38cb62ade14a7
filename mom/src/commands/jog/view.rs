//! What `mom jog` shows.

use mom_arm::ArmState;
use mom_client::LinkState;
use ratatui::Frame;
use ratatui::style::Stylize as _;
use ratatui::text::{Line, Span, Text};
use ratatui::widgets::Paragraph;

use crate::output::words;

const KEYS: [&str; 3] = [
    "hold ← → left, right   ↑ ↓ away, near   r f up, down   q e spin   t g tilt",
    "o c open, close the jaws   h home   + - faster, slower   space rest",
    "Esc ends: the token is released, and the hub halts the robot",
];

/// All that is shown.
pub(super) struct View {
    channel: String,
    fence: u64,
    pub(super) link: LinkState,
    pub(super) state: Option<ArmState>,
    /// mm/s.
    pub(super) speed: f64,
    /// What the robot refused last.
    pub(super) refusal: Option<String>,
}

impl View {
    pub(super) fn new(channel: &str, fence: u64) -> View {
        View {
            channel: words::visible(channel),
            fence,
            link: LinkState::Connected,
            state: None,
            speed: 0.0,
            refusal: None,
        }
    }

    pub(super) fn draw(&self, frame: &mut Frame<'_>) {
        frame.render_widget(Paragraph::new(self.text()), frame.area());
    }

    fn text(&self) -> Text<'static> {
        let title = format!("{}  fence {}  {:.0} mm/s", self.channel, self.fence, self.speed);
        let mut lines = vec![Line::from(title.bold()), self.link_line(), Line::default()];
        match &self.state {
            None => lines.push(Line::from("the robot has not told its state yet".dim())),
            Some(state) => lines.extend(state_lines(state)),
        }
        let refusal = self.refusal.clone().unwrap_or_default();
        lines.extend([Line::default(), Line::from(refusal.red()), Line::default()]);
        lines.extend(KEYS.map(|text| Line::from(text.dim())));
        Text::from(lines)
    }

    fn link_line(&self) -> Line<'static> {
        match &self.link {
            LinkState::Connected => Line::from("connected".green()),
            LinkState::Stale { .. } => Line::from("nothing was heard of the hub lately".yellow()),
            _ => Line::from("not connected".red()),
        }
    }
}

fn state_lines(state: &ArmState) -> Vec<Line<'static>> {
    let pose = &state.pose;
    let place = format!("x {:7.1}   y {:7.1}   z {:7.1} mm", pose.x, pose.y, pose.z);
    let turn = format!("spin {:6.1}   tilt {:6.1} degrees", pose.spin, pose.tilt);
    let holding = match &state.holding {
        Some(block) => format!("the jaws hold {}", words::visible(block)),
        None => format!("the jaws are {:.0} mm open", state.gripper.opening),
    };
    let motion: Span<'static> = match (state.stopped, state.moving) {
        (true, _) => "stopped: let it go with mom unstop".red(),
        (_, true) => "moving".yellow(),
        _ => "at rest".green(),
    };
    vec![
        Line::from(place),
        Line::from(turn),
        Line::from(holding),
        Line::from(motion),
    ]
}
