//! Drives the robot and stops it, through a hub of its own: the real programs over real sockets.

use std::io::{BufRead as _, BufReader, Write as _};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

/// Programs that run, and end with the test.
struct Programs {
    hub: String,
    running: Vec<Child>,
}

impl Drop for Programs {
    fn drop(&mut self) {
        for mut program in self.running.drain(..).rev() {
            let _ = program.kill();
            let _ = program.wait();
        }
    }
}

impl Programs {
    fn start() -> Programs {
        let mut hub = Command::new("mom-broker")
            .args(["--config", "hub.toml", "--listen", "127.0.0.1:0"])
            .stderr(Stdio::piped())
            .spawn()
            .expect("mom-broker is installed");
        let said = BufReader::new(hub.stderr.take().unwrap()).lines();
        let address = said.map_while(Result::ok).find_map(|line| {
            let (_, rest) = line.split_once("addresses=[")?;
            Some(rest.split([',', ']']).next()?.to_owned())
        });
        let mut programs = Programs {
            hub: format!("bin://{}", address.expect("its address")),
            running: vec![hub],
        };
        let robot = Command::new(env!("CARGO_BIN_EXE_newbot")).env("MOM_HUB", &programs.hub).spawn();
        programs.running.push(robot.unwrap());
        // Until it is in its channel.
        let begin = Instant::now();
        while !programs.mom(&["card", "/newbot/robot"], "").status.success() {
            assert!(begin.elapsed() < Duration::from_secs(30), "it never comes to its channel");
        }
        programs
    }

    fn mom(&self, words: &[&str], script: &str) -> Output {
        let mut mom = Command::new("mom")
            .args(words)
            .envs([("MOM_HUB", &*self.hub), ("MOM_USER", "operator")])
            .env("MOM_PASSWORD", std::fs::read_to_string("operator.password").unwrap().trim())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("mom is installed");
        let _ = mom.stdin.take().unwrap().write_all(script.as_bytes());
        mom.wait_with_output().unwrap()
    }

    /// Tries to drive until it is refused in these words: it looks at its emergency stop each 150 ms.
    fn until_refused(&self, words: &str) {
        let refused = (0..100).any(|_| String::from_utf8_lossy(&self.run("drive 1").stdout).contains(words));
        assert!(refused, "never: {words}");
    }

    fn run(&self, script: &str) -> Output {
        self.mom(&["run", "--channel", "/newbot/robot", "--token", "/newbot/token", "-"], script)
    }
}

#[test]
fn it_says_what_it_can_do_drives_and_stops() {
    let programs = Programs::start();
    let card = programs.mom(&["card", "/newbot/robot"], "");
    assert!(String::from_utf8_lossy(&card.stdout).contains("drive"), "{card:?}");

    let done = programs.run("drive 100; turn 30\ndrive -50\n");
    assert!(done.status.success(), "{done:?}");
    let refused = programs.run("drive 5000");
    assert_eq!(refused.status.code(), Some(1), "{refused:?}");
    assert!(String::from_utf8_lossy(&refused.stderr).contains("-2000 to 2000 mm"));

    // Its emergency stop holds until it is reset and the stop is lifted.
    std::fs::write("estop", "").unwrap();
    programs.until_refused("emergency stop");
    let lifted = programs.mom(&["unstop", "/newbot"], "");
    assert!(String::from_utf8_lossy(&lifted.stdout).contains("emergency stop"), "{lifted:?}");
    let refused = programs.run("drive 1");
    assert!(String::from_utf8_lossy(&refused.stdout).contains("emergency stop"), "{refused:?}");
    std::fs::remove_file("estop").unwrap();
    programs.until_refused("is stopped");
    assert!(programs.mom(&["unstop", "/newbot"], "").status.success());

    assert!(programs.mom(&["stop", "/newbot"], "").status.success());
    assert!(!programs.run("drive 100").status.success());
    assert!(programs.mom(&["unstop", "/newbot"], "").status.success());
    let done = programs.run("drive 20");
    assert!(done.status.success(), "{done:?}");
}
