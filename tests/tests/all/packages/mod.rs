//! What `cargo xtask dist` packs, installed as an administrator installs it: on machines inside this one.

mod container;

use std::io;
use std::os::unix::fs::PermissionsExt as _;
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use mom_tests::machine::Machine;
use mom_tests::programs::{PATIENCE, Running, build, program, project, text};

/// How exposed the service may be at most, in tenths, as `systemd-analyze` judges it.
const EXPOSURE: &str = "25";

const PASSWORD: [(&str, &str); 1] = [("MOM_PASSWORD", "secret")];

/// The packages for Debian, by their names.
const PACKAGES: [&str; 2] = ["mom", "mom-robot"];

/// The links to `mom-device`, and what each is.
const LINKS: &[(&str, &str)] = &include!("../../../../mom-robot/names.rs");

/// Packs the programs of the tests in the same way as those that are shipped; the packages.
fn packed(out: &Path) -> [PathBuf; 2] {
    packed_with("022", out)
}

fn packed_with(umask: &str, out: &Path) -> [PathBuf; 2] {
    let programs = program("mom");
    let mut dist = Command::new("sh");
    dist.args(["-c", &format!("umask {umask}; exec \"$@\""), "sh"]);
    dist.arg(build(&["xtask"]).join("xtask"))
        .args(["dist", "--fast", "--programs"]);
    dist.arg(programs.parent().expect("a folder"))
        .arg("--out")
        .arg(out);
    let packed = dist.current_dir(project()).output().expect("it runs");
    let said = text(&packed.stdout) + &text(&packed.stderr);
    assert!(packed.status.success(), "{said}");
    PACKAGES.map(|name| {
        let file = format!("/{name}_");
        let package = said
            .lines()
            .find(|line| line.ends_with(".deb") && line.contains(&file));
        package.expect("its name is told").into()
    })
}

/// A machine that begins with these files and has the packages at `/mnt/mom.deb` and `/mnt/mom-robot.deb`.
fn machine(base: &Path) -> io::Result<Machine> {
    let machine = Machine::start(base)?;
    let out = tempfile::tempdir()?;
    for (name, package) in PACKAGES.iter().zip(packed(&out.path().join("dist"))) {
        std::fs::copy(package, machine.shared().join(format!("{name}.deb")))?;
    }
    Ok(machine)
}

fn lines_of(mut command: Command) -> Vec<String> {
    let output = command.output().expect("it runs");
    assert!(output.status.success(), "{}", text(&output.stderr));
    text(&output.stdout).lines().map(str::to_owned).collect()
}

/// What is in an archive and in a package: the file's path in each.
const MOM: &[(&str, &str)] = &[
    ("bin/mom", "./usr/bin/mom"),
    ("bin/mom-broker", "./usr/bin/mom-broker"),
    ("man/mom-grab.1", "./usr/share/man/man1/mom-grab.1.gz"),
    (
        "man/mom-broker-passwd.1",
        "./usr/share/man/man1/mom-broker-passwd.1.gz",
    ),
    (
        "completions/bash/mom",
        "./usr/share/bash-completion/completions/mom",
    ),
    ("config/lab.toml", "./usr/share/doc/mom/examples/lab.toml"),
    ("licences", "./usr/share/doc/mom/licences.gz"),
    ("mom-broker.service", "./lib/systemd/system/mom-broker.service"),
];
const ROBOT: &[(&str, &str)] = &[
    ("bin/mom-device", "./usr/bin/mom-device"),
    ("man/mom-device.1", "./usr/share/man/man1/mom-device.1.gz"),
    ("man/mom-mcp.1", "./usr/share/man/man1/mom-mcp.1.gz"),
    (
        "completions/zsh/_mom-arm",
        "./usr/share/zsh/vendor-completions/_mom-arm",
    ),
    (
        "completions/fish/mom-camera.fish",
        "./usr/share/fish/vendor_completions.d/mom-camera.fish",
    ),
    ("licences", "./usr/share/doc/mom-robot/licences.gz"),
    (
        "mom-linuxbot.service",
        "./lib/systemd/system/mom-linuxbot.service",
    ),
];

#[test]
fn archive_and_package_have_the_same_programs_and_all_pages() {
    let folder = tempfile::tempdir().expect("a folder");
    let packages = packed(&folder.path().join("dist"));
    let dist = packages[0].parent().expect("a folder");
    let mut sums = Command::new("sha256sum");
    sums.current_dir(dist).args(["--check", "SHA256SUMS"]);
    let sums = lines_of(sums);
    assert_eq!(sums.len(), 6, "{sums:?}");
    // Packing the same commit gives the same files, with other settings too.
    let again = packed_with("077", &folder.path().join("again"));
    let sums_of = |package: &Path| std::fs::read_to_string(package.with_file_name("SHA256SUMS"));
    assert_eq!(
        sums_of(&packages[0]).expect("a file"),
        sums_of(&again[0]).expect("a file")
    );
    let files = [MOM, ROBOT];
    for ((package, path), files) in PACKAGES.iter().zip(&packages).zip(files) {
        let begins = |line: &&String| {
            let rest = line.strip_prefix(package);
            rest.is_some_and(|rest| {
                rest.starts_with('-') && !rest.starts_with("-robot") && !rest.starts_with("-debug")
            })
        };
        let archive = sums
            .iter()
            .filter(begins)
            .find_map(|line| line.split_once(".tar.gz:"));
        let name = archive.expect("an archive").0;
        let mut tar = Command::new("tar");
        tar.current_dir(dist).args(["-tvzf", &format!("{name}.tar.gz")]);
        let archived = lines_of(tar);
        let mut dpkg = Command::new("dpkg-deb");
        dpkg.arg("--contents").arg(path);
        let installed = lines_of(dpkg);
        let mut files: Vec<(String, String)> = files
            .iter()
            .map(|(tar, deb)| ((*tar).to_owned(), (*deb).to_owned()))
            .collect();
        if *package == "mom-robot" {
            let link = |(name, _): &(&str, &str)| {
                let link = format!("{name} -> mom-device");
                (format!("bin/{link}"), format!("./usr/bin/{link}"))
            };
            files.extend(LINKS.iter().map(link));
        }
        for (tar, deb) in files {
            for (listed, file) in [
                (&archived, format!(" {name}/{tar}")),
                (&installed, format!(" {deb}")),
            ] {
                let found = listed.iter().find(|line| line.ends_with(&file));
                assert!(
                    found.is_some_and(|line| line.contains(" root/root ")),
                    "{file}: {listed:?}"
                );
            }
        }
        let programs = installed
            .iter()
            .filter(|line| line.contains(" ./usr/bin/mom"))
            .count();
        let expected = if *package == "mom" { 2 } else { 1 + LINKS.len() };
        assert_eq!(programs, expected, "{installed:?}");
    }
}

/// What a crash tells as addresses becomes files and lines as soon as the debug info lies beside the program.
#[test]
fn a_packed_program_finds_its_debug_info() {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("dist");
    packed(&out);
    let unpack = |begin: &str| {
        let mut list = Command::new("sh");
        let each = format!(
            "for f in {begin}-[0-9]*.tar.gz; do tar -xzf $f --strip-components=1 --one-top-level=at; done"
        );
        list.current_dir(&out).args(["-ec", &each]);
        lines_of(list);
    };
    unpack("mom-robot");
    let program = out.join("at/bin/mom-device");
    let place = |address: &str| {
        let mut line = Command::new("addr2line");
        lines_of({
            line.arg("-e").arg(&program).arg(address);
            line
        })
    };
    unpack("mom-debug");
    let info = out.join("at/mom-device.debug");
    let mut names = Command::new("nm");
    names.arg("--demangle").arg(&info);
    let names = lines_of(names);
    let main = names.iter().find(|line| line.ends_with("mom_device::main"));
    let address = main
        .and_then(|line| line.split(' ').next())
        .expect("it has a main");
    assert_eq!(place(address), ["??:0"]);
    std::fs::create_dir(out.join("at/bin/.debug")).expect("a folder");
    std::fs::rename(info, out.join("at/bin/.debug/mom-device.debug")).expect("it is moved");
    let found = place(address);
    assert!(found[0].contains("mom-robot/src/main.rs:"), "{found:?}");
}

#[test]
fn the_services_are_not_exposed() {
    for unit in ["mom-broker.service", "mom-linuxbot.service"] {
        let mut analyze = Command::new("systemd-analyze");
        analyze.args(["security", "--offline=yes", "--no-pager", "--threshold", EXPOSURE]);
        let judged = analyze
            .arg(project().join("packages").join(unit))
            .output()
            .expect("systemd is installed, it need not run");
        let said = text(&judged.stdout) + &text(&judged.stderr);
        assert!(
            judged.status.success() && said.contains("Overall exposure level"),
            "{said}"
        );
    }
}

/// The installed unit.
struct Unit(String);

impl Unit {
    fn of(machine: &Machine) -> Unit {
        Unit(machine.sh("cat /lib/systemd/system/mom-broker.service", &[]))
    }

    fn value(&self, key: &str) -> &str {
        let mut lines = self.0.lines();
        let value = lines.find_map(|line| line.strip_prefix(key)?.strip_prefix('='));
        value.unwrap_or_else(|| panic!("no {key} in {}", self.0))
    }

    /// Starts the service as systemd does: its command, its user without any privilege, and what it is told.
    fn start(&self, machine: &Machine) -> Running {
        assert_eq!(self.value("Type"), "notify");
        let socket = machine.shared().join("notify");
        // What the service before it left.
        let _ = std::fs::remove_file(&socket);
        let ready = UnixDatagram::bind(&socket).expect("a socket");
        let all = std::fs::Permissions::from_mode(0o777);
        std::fs::set_permissions(&socket, all).expect("everybody may write to it");
        ready.set_read_timeout(Some(PATIENCE)).expect("it may end");
        let (user, group) = (self.value("User"), self.value("Group"));
        let mut command = machine.command("setpriv");
        command.args([
            &format!("--reuid={user}"),
            &format!("--regid={group}"),
            "--init-groups",
        ]);
        command.args([
            "--no-new-privs",
            "--inh-caps=-all",
            "--bounding-set=-all",
            "sh",
            "-c",
        ]);
        command.arg(format!(
            "umask {}; exec {} 2>&1",
            self.value("UMask"),
            self.value("ExecStart")
        ));
        command.env(
            "STATE_DIRECTORY",
            format!("/var/lib/{}", self.value("StateDirectory")),
        );
        command.env("NOTIFY_SOCKET", "/mnt/notify");
        let running = Running::of("mom-broker", &mut command);
        let mut said = [0; 64];
        let length = ready.recv(&mut said).expect("it says that it listens");
        assert_eq!(&said[..length], b"READY=1");
        running
    }
}

/// The packages as an administrator meets them, up to a robot that is driven.
#[test]
fn who_installs_the_package_drives_a_robot() {
    let machine = match machine(Path::new("/")) {
        Ok(machine) => machine,
        Err(error) => return eprintln!("left out: no machines inside this one: {error}"),
    };
    let install = "DEBIAN_FRONTEND=noninteractive dpkg --install /mnt/mom.deb /mnt/mom-robot.deb";
    let told = machine.sh(install, &[]);
    let typed: Vec<&str> = told.lines().filter_map(|line| line.strip_prefix("  ")).collect();
    let [passwd, tree] = typed[..] else {
        panic!("two commands: {told}")
    };
    machine.sh(
        "test -L /etc/systemd/system/multi-user.target.wants/mom-broker.service",
        &[],
    );
    let unit = Unit::of(&machine);
    let broker = unit.start(&machine);

    // Nobody is there; then alice is.
    let mut stranger = machine.command("mom");
    let refused = stranger.args(["--user", "alice", "tree"]).envs(PASSWORD).output();
    let refused = refused.expect("it runs");
    assert!(!refused.status.success() && text(&refused.stderr).contains("alice"));
    machine.sh(passwd, &PASSWORD);
    broker.line_with("new users alice");
    machine.sh(tree, &PASSWORD);
    let read = "setpriv --reuid=nobody --clear-groups cat /etc/mom/users.toml || true";
    let secret = machine.sh(read, &[]);
    assert!(secret.contains("Permission denied"), "{secret}");

    // The example of the file, with a robot.
    machine.sh(
        r"sed -i '/^# \[managers.one-at-a-time\]/,$ s/^# \?//' /etc/mom/mom.toml",
        &[],
    );
    // Written at once: the broker may read the file at any time.
    let device = r#"printf '\n[[users]]\nname = "arm"\ngroups = ["device"]\n' > /mnt/arm.toml
        mom keygen --out /mnt/arm.key >> /mnt/arm.toml
        cat /mnt/arm.toml >> /etc/mom/users.toml
        mom-broker check /etc/mom/mom.toml"#;
    machine.sh(device, &[]);
    broker.line_with("new users arm");
    let mut arm = machine.command("mom-arm");
    let arm = Running::of(
        "mom-arm",
        arm.args(["--key", "/mnt/arm.key"]).stderr(Stdio::null()),
    );
    let joined = std::time::Instant::now();
    while !machine.sh(tree, &PASSWORD).contains("channel  arm") {
        assert!(joined.elapsed() < PATIENCE, "the arm joins");
    }
    let ran = machine.sh(
        "echo 'move 100 50 200 0 0; home' | mom --user alice run -",
        &PASSWORD,
    );
    assert!(ran.contains("holding /robot/token"), "{ran}");
    let stopped = machine.sh("mom --user alice stop", &PASSWORD);
    assert!(stopped.contains("/robot/arm: arm stands"), "{stopped}");

    // systemd's `reload`, `restart`, and an upgrade that leaves the files alone.
    let reload = unit.value("ExecReload");
    machine.sh(&reload.replace("$MAINPID", &broker.id().to_string()), &[]);
    broker.line_with("SIGHUP");
    broker.signal("TERM");
    assert_eq!(broker.wait().code(), Some(0));
    let again = machine.sh(install, &[]);
    assert!(!again.contains("passwd"), "{again}");
    let broker = unit.start(&machine);
    machine.sh(tree, &PASSWORD);
    arm.signal("INT");
    assert_eq!(arm.wait().code(), Some(0));
    broker.signal("TERM");
    assert_eq!(broker.wait().code(), Some(0));

    let left = "ls -d /etc/mom/* /var/lib/mom/* /usr/bin/mom* 2>/dev/null || true";
    machine.sh("dpkg --remove mom mom-robot", &[]);
    let kept = machine.sh(left, &[]);
    assert!(
        kept.contains("/etc/mom/users.toml") && kept.contains("/var/lib/mom/hub.key"),
        "{kept}"
    );
    assert!(!kept.contains("/usr/bin"), "{kept}");
    machine.sh("dpkg --purge mom mom-robot", &[]);
    assert_eq!(machine.sh(left, &[]), "");
}
