//! What a lab says of itself: where everything is, and what to type next.

use std::net::SocketAddr;

use mom_broker::UserEntry;
use mom_camera::{CameraOptions, View};
use mom_client::Fingerprint;
use mom_model::ModelOptions;
use mom_wheels::Simulated;
use serde_json::{Value as Json, json};

use super::cubo::PATH as CUBO;
use super::{Kind, TWO_ARMS, USUAL};
use crate::output::style::{Tone, ink, padded};

/// So many robots of a fleet are proposed to drive: more lines nobody reads.
const FORMED: usize = 3;
/// How far each drives, in mm: less than its neighbours are away.
const ASIDE: f64 = 300.0;

/// The token of an arm's channel.
fn token_of(channel: &str) -> String {
    channel.replace("/arm", "/token")
}

/// The URL of a robot's page.
fn page_of(address: &SocketAddr) -> String {
    format!("http://{address}/")
}

/// Lines by which the first robots drive, each to a point of its own between its neighbours', and then all blink.
fn formation(robots: u16) -> String {
    let goals = Simulated::fleet(robots)
        .into_iter()
        .take(FORMED)
        .zip(1..)
        .map(|(mut robot, unit)| {
            let at = robot.pose(0);
            format!("{unit}: goto {:.0} {:.0}\\n", at.x + ASIDE, at.y + ASIDE / 2.0)
        });
    format!("{}---\\nall: leds 255\\n", goals.collect::<String>())
}

/// The summary of a running lab.
pub(super) struct LabSummary {
    pub(super) address: SocketAddr,
    pub(super) pin: Option<Fingerprint>,
    /// Whether the console is built in.
    pub(super) console: bool,
    pub(super) program: String,
    pub(super) users: Vec<UserEntry>,
    pub(super) kind: Kind,
    /// The pages of the fleet's robots, that of robot 1 first.
    pub(super) pages: Vec<SocketAddr>,
}

impl LabSummary {
    pub(super) fn json(&self) -> Json {
        let people = self
            .users
            .iter()
            .map(|user| json!({"name": user.name, "level": user.level, "groups": user.groups}));
        json!({
            "state": "ready",
            "hub": format!("bin://{}", self.address),
            "xml": format!("tcp://{}", self.address),
            "tls": self.tls(),
            "console": self.console.then(|| self.page()),
            "users": people.collect::<Vec<_>>(),
            "pages": self.pages.iter().map(page_of).collect::<Vec<_>>(),
        })
    }

    pub(super) fn text(&self) -> String {
        let row = |label: &str, text: String| format!("  {}  {text}", padded(label, 7, Tone::Faint));
        let place = |text: &str| ink(text, Tone::Place);
        let mut lines = vec![
            ink(
                match self.kind {
                    Kind::Arm => {
                        "A hub, a robot arm, five cameras and two agents are running here. Ctrl-C ends them."
                            .to_owned()
                    }
                    Kind::TwoArms => {
                        "A hub and two robot arms over one table are running here. Ctrl-C ends them."
                            .to_owned()
                    }
                    Kind::Cubo => {
                        "A hub, the robot CUBO and the computer that thinks for it are running here. Ctrl-C ends them."
                            .to_owned()
                    }
                    Kind::Fleet { robots, .. } => format!(
                        "A hub, {robots} robots and their base station are running here. Ctrl-C ends them."
                    ),
                },
                Tone::Strong,
            ),
            String::new(),
            row(
                "hub",
                format!("{}  binary", place(&format!("bin://{}", self.address))),
            ),
            row(
                "",
                format!(
                    "{}  XML, for anything that can open a socket",
                    place(&format!("tcp://{}", self.address))
                ),
            ),
        ];
        lines.extend(self.tls().map(|address| {
            row(
                "",
                format!("{}  binary with TLS; tcps:// for XML", place(&address)),
            )
        }));
        lines.push(row(
            "people",
            format!("{}; everyone's password is their name", self.people()),
        ));
        lines.extend(self.devices().into_iter().map(|(label, text)| row(label, text)));
        lines.extend([row("chat", place("/chat")), String::new()]);
        lines.extend(self.console_proposal());
        lines.extend(match self.kind {
            Kind::Arm => self.proposals(),
            Kind::TwoArms => self.proposals_for_two(),
            Kind::Fleet { robots, together } => self.proposals_for_fleet(robots, together),
            Kind::Cubo => self.proposals_for_cubo(),
        });
        lines.join("\n")
    }

    /// What can be driven, and looked at.
    fn devices(&self) -> Vec<(&'static str, String)> {
        let place = |text: &str| ink(text, Tone::Place);
        if let Kind::Fleet { robots, together } = self.kind {
            return self.fleet(robots, together);
        }
        if matches!(self.kind, Kind::Cubo) {
            let robot = format!(
                "{}, driven by the owner of {}",
                place(&format!("{CUBO}/robot")),
                place(&format!("{CUBO}/token"))
            );
            let mirror = format!(
                "{}, what is wanted and what is confirmed of each element",
                place(&format!("{CUBO}/simulacrum"))
            );
            let camera = place(&format!("{CUBO}/camera"));
            return vec![("robot", robot), ("mirror", mirror), ("camera", camera)];
        }
        if matches!(self.kind, Kind::TwoArms) {
            let robots = TWO_ARMS.map(|(_, channel, _)| {
                format!(
                    "{}, driven by the owner of {}",
                    place(channel),
                    place(&token_of(channel))
                )
            });
            let [first, second] = robots;
            let zones = ["/zone/left", "/zone/middle", "/zone/right", "/zone/table"]
                .map(place)
                .join(", ");
            return vec![
                ("robots", first),
                ("", second),
                ("zones", format!("{zones}; an arm enters those of its driver")),
            ];
        }
        let cameras = View::ALL
            .map(|view| place(&CameraOptions::new(view).channel))
            .join(", ");
        let robot = format!(
            "{}, driven by the owner of {}",
            place("/robot/arm"),
            place("/robot/token")
        );
        let turning = CameraOptions::new(View::Pan);
        let pan = format!(
            "{} turns for the owner of {}",
            place(&turning.channel),
            place(&turning.token)
        );
        let objects = place(&ModelOptions::default().channel);
        vec![
            ("robot", robot),
            ("cameras", cameras),
            ("", pan),
            ("objects", objects),
        ]
    }

    /// The same of a fleet.
    fn fleet(&self, robots: u16, together: bool) -> Vec<(&'static str, String)> {
        let place = |text: &str| ink(text, Tone::Place);
        let all = format!(
            "{} … {}",
            place("/fleet/1/robot"),
            place(&format!("/fleet/{robots}/robot"))
        );
        let token = match together {
            true => format!("driven together by the owner of {}", place("/fleet/token")),
            false => format!(
                "each driven by the owner of its token, such as {}",
                place("/fleet/1/token")
            ),
        };
        let mut devices = vec![
            ("robots", format!("{all}, {token}")),
            (
                "states",
                format!("{}, the newest of each", place("/fleet/status")),
            ),
        ];
        if let (Some(page), seen) = (self.pages.first(), self.pages.len()) {
            let (camera, page) = (place("/fleet/1/camera"), place(&page_of(page)));
            let others = match seen {
                1 => String::new(),
                _ => format!("; robots 2 to {seen} have theirs"),
            };
            devices.push(("eyes", format!("{camera}, and robot 1's own page {page}{others}")));
        }
        devices
    }

    /// Where the console is, or how to get it.
    fn console_proposal(&self) -> Vec<String> {
        if !self.console {
            let command = ink("cargo xtask lab --install", Tone::Command);
            let text = "The console is not built into this program; in a checkout, this builds it and starts the lab with it:";
            return vec![format!("{text} {command}")];
        }
        vec![
            "Open in a browser, and log in as alice with the password alice:".to_owned(),
            format!("  {}", ink(self.page(), Tone::Place)),
        ]
    }

    /// The address of the console.
    fn page(&self) -> String {
        format!("http://{}/", self.address)
    }

    /// What to type next, with two arms.
    fn proposals_for_two(&self) -> Vec<String> {
        let program = &self.program;
        let export = |name: &str| {
            let words = format!("export {}MOM_USER={name} MOM_PASSWORD={name}", self.hub());
            format!("  {}", ink(words, Tone::Command))
        };
        let command = |text: &str| format!("  {}", ink(text.replace("MOM", program), Tone::Command));
        vec![
            "Try in another terminal, as alice:".to_owned(),
            export("alice"),
            command("echo 'move -100 0 100 0 0' | MOM run --zone /zone/left -"),
            command("echo 'move 250 0 100 0 0' | MOM run --zone /zone/left -"),
            command(
                "echo 'move 250 0 100 0 0; wait 20000; home' | MOM run --zone /zone/left --zone /zone/middle -",
            ),
            "and meanwhile, in a third one, as bob:".to_owned(),
            export("bob"),
            command(
                "echo 'move 0 0 100 0 0' | MOM run --channel /robot-2/arm --token /robot-2/token --zone /zone/right -",
            ),
            command("MOM grab /zone/middle"),
            command("MOM watch --recursive /zone"),
        ]
    }

    /// What to type next, with a thin robot.
    fn proposals_for_cubo(&self) -> Vec<String> {
        let program = &self.program;
        let person = |name: &str| format!("export {}MOM_USER={name} MOM_PASSWORD={name}", self.hub());
        let command = |text: &str| format!("  {}", ink(text.replace("MOM", program), Tone::Command));
        let export = |name: &str| format!("  {}", ink(person(name), Tone::Command));
        vec![
            "Try in another terminal, as alice:".to_owned(),
            export("alice"),
            command("MOM fleet send 1 'via 2800 2500 2800 2800 2500 2800 2500 2500'"),
            command("MOM fleet send 1 'set joints 45 -45 10; do gesture 3'"),
            command("MOM fleet send 1 'set left-wheel 100 right-wheel -100 for 2000'"),
            command("MOM fleet send 1 'period 40'"),
            command("MOM watch /fleet/1/simulacrum"),
            command("MOM stop /fleet"),
            command("MOM unstop /fleet"),
            "and meanwhile, in a third one, as carol, who may take what alice has:".to_owned(),
            export("carol"),
            command(&format!("MOM grab {CUBO}/token")),
        ]
    }

    /// What to type next, with a fleet.
    fn proposals_for_fleet(&self, robots: u16, together: bool) -> Vec<String> {
        let program = &self.program;
        let person = |name: &str| format!("export {}MOM_USER={name} MOM_PASSWORD={name}", self.hub());
        let command = |text: &str| format!("  {}", ink(text.replace("MOM", program), Tone::Command));
        let export = |name: &str| format!("  {}", ink(person(name), Tone::Command));
        let robot = match together {
            true => "/fleet/token",
            false => "/fleet/1/token",
        };
        vec![
            "Try in another terminal, as alice:".to_owned(),
            export("alice"),
            command("MOM fleet list"),
            command("MOM snap camera --session /fleet/1"),
            command("MOM fleet send 1 'motor 200 200 1000; leds 255'"),
            command(&format!("printf '{}' | MOM fleet run -", formation(robots))),
            command("MOM stop /fleet"),
            command("MOM unstop /fleet"),
            "and meanwhile, in a third one, as carol, who may take what alice has:".to_owned(),
            export("carol"),
            command(&format!("MOM grab {robot}")),
            command("MOM watch --recursive /fleet"),
        ]
    }

    /// What to type next.
    fn proposals(&self) -> Vec<String> {
        let program = &self.program;
        let person = |name: &str| format!("export {}MOM_USER={name} MOM_PASSWORD={name}", self.hub());
        let command = |text: &str| format!("  {}", ink(text.replace("MOM", program), Tone::Command));
        let export = |name: &str| format!("  {}", ink(person(name), Tone::Command));
        vec![
            "Try in another terminal, as alice:".to_owned(),
            export("alice"),
            command("MOM tree"),
            command("echo 'move 100 50 200 0 0; grip close' | MOM run -"),
            command("MOM jog --for 1s 50 0 -50 0 0"),
            command("MOM stop /robot/arm"),
            command("MOM unstop /robot/arm"),
            command("MOM aim 20 -10"),
            command("MOM snap pan"),
            command("MOM snap"),
            command("MOM servo red green"),
            command("MOM camera x --size 320x240 --quality 60"),
            command("MOM put red on blue"),
            command("echo reset | MOM run -"),
            command("MOM grab --answer /robot/token"),
            "and while she holds the token, in a third one, as bob:".to_owned(),
            export("bob"),
            command("MOM grab --wait 5m /robot/token"),
            command("MOM token /robot/token"),
            command("MOM watch --recursive /robot"),
        ]
    }

    /// The address with TLS, which knows the hub by its certificate.
    fn tls(&self) -> Option<String> {
        let pin = self.pin?;
        Some(format!("bins://{}?pin={pin}", self.address))
    }

    /// The users that are neither devices nor agents.
    fn people(&self) -> String {
        let people = self.users.iter().filter(|user| {
            !user
                .groups
                .iter()
                .any(|group| group == "device" || group == "agent")
        });
        let people: Vec<String> = people
            .map(|user| {
                let mut facts = vec![format!("level {}", user.level)];
                facts.extend(user.groups.iter().cloned());
                format!("{} ({})", ink(&user.name, Tone::Peer), facts.join(", "))
            })
            .collect();
        people.join(", ")
    }

    /// The hub's address, if it is not the default.
    fn hub(&self) -> String {
        match self.address.to_string() == USUAL {
            true => String::new(),
            false => format!("MOM_HUB=bin://{} ", self.address),
        }
    }
}

#[cfg(test)]
mod tests {
    use mom_broker::Config;

    use super::super::within_reach;
    use super::*;

    fn lab(address: &str, console: bool) -> String {
        let lab = LabSummary {
            address: address.parse().unwrap(),
            pin: Some(Fingerprint::new([0xAB; 32])),
            console,
            program: "target/release/mom".to_owned(),
            users: Config::lab().users,
            kind: Kind::Arm,
            pages: Vec::new(),
        };
        anstream::adapter::strip_str(&lab.text()).to_string()
    }

    #[test]
    fn commands_can_be_copied() {
        let usual = lab(USUAL, true);
        for part in [
            "bin://127.0.0.1:7666",
            "tcp://127.0.0.1:7666",
            "bins://127.0.0.1:7666?pin=sha256:abab",
            "alice (level 1), bob (level 1), carol (level 5, operator);",
            "\n  export MOM_USER=alice MOM_PASSWORD=alice\n",
            "\nOpen in a browser, and log in as alice with the password alice:\n  http://127.0.0.1:7666/\n",
            "\n  target/release/mom tree\n",
            "\n  echo 'move 100 50 200 0 0; grip close' | target/release/mom run -\n",
        ] {
            assert!(usual.contains(part), "{part:?} in\n{usual}");
        }
        let other = lab("[::1]:4000", false);
        assert!(
            other.contains("export MOM_HUB=bin://[::1]:4000 MOM_USER=alice MOM_PASSWORD=alice\n"),
            "{other}"
        );
        assert!(
            other.contains("export MOM_HUB=bin://[::1]:4000 MOM_USER=bob"),
            "{other}"
        );
        assert!(
            other.contains("starts the lab with it: cargo xtask lab --install\n")
                && !other.contains("http://"),
            "{other}"
        );
    }

    #[test]
    fn each_robot_of_the_fleet_is_sent_to_a_point_of_its_own() {
        assert_eq!(
            formation(10),
            "1: goto 800 650\\n2: goto 1800 650\\n3: goto 2800 650\\n---\\nall: leds 255\\n"
        );
        assert_eq!(
            formation(3),
            "1: goto 800 650\\n2: goto 1800 650\\n3: goto 800 1650\\n---\\nall: leds 255\\n"
        );
        assert_eq!(formation(1), "1: goto 800 650\\n---\\nall: leds 255\\n");
    }

    #[test]
    fn addresses_can_be_connected_to() {
        for (bound, told) in [
            ("0.0.0.0:1", "127.0.0.1:1"),
            ("[::]:2", "[::1]:2"),
            ("10.0.0.5:3", "10.0.0.5:3"),
        ] {
            assert_eq!(within_reach(bound.parse().unwrap()).to_string(), told);
        }
    }

    #[test]
    fn the_lab_is_where_everybody_looks() {
        assert_eq!(Config::lab().listen, [USUAL.into()]);
    }
}
