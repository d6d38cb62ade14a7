//! What the command lines of all programs have alike: man pages and shell completions, which each program writes itself, so that they are
//! those of the program that is installed; times; and what asks them to end.

mod interrupt;
mod times;

use std::ffi::OsString;
use std::path::Path;
use std::{env, fs, io};

use clap::CommandFactory;
use clap_complete::env::{CompleteEnv, Shells};

pub use interrupt::Interrupt;
pub use times::{duration, duration_within};

/// The first of the two arguments that ask for them. It is not an option of the programs, because it is for packagers only.
pub const ASK: &str = "--write-pages";

/// The variable by which a shell asks a program what may come next on its command line, with the shell's name. Not the library's own,
/// `COMPLETE`: a service that inherits a variable of so common a name would complete a line instead of running.
pub const COMPLETE: &str = "MOM_COMPLETE";

/// Answers a shell that asks for completions, or writes the pages of a program that was started with [`ASK`] and a folder after its name;
/// none = it was asked for something else.
pub fn asked<C: CommandFactory>(args: &[OsString]) -> Option<io::Result<()>> {
    let completing = CompleteEnv::with_factory(C::command).var(COMPLETE);
    match completing.try_complete(args, env::current_dir().ok().as_deref()) {
        Ok(false) => {}
        Ok(true) => return Some(Ok(())),
        Err(error) => return Some(Err(io::Error::other(error))),
    }
    let [_, ask, folder] = args else { return None };
    (ask == ASK).then(|| write(&C::command(), Path::new(folder)))
}

/// Writes `man/*.1`, a page for each command, and a file for each of the shells `bash`, `zsh` and `fish` into folders of
/// their names, named as each shell looks for it: by it the shell asks the program itself what completes a line.
///
/// # Errors
/// A folder or file that cannot be written.
pub fn write(command: &clap::Command, folder: &Path) -> io::Result<()> {
    let man = folder.join("man");
    fs::create_dir_all(&man)?;
    clap_mangen::generate_to(command.clone(), &man)?;
    for page in fs::read_dir(&man)? {
        let page = page?.path();
        fs::write(&page, with_examples(&fs::read_to_string(&page)?))?;
    }
    let name = command.get_name();
    let shells = Shells::builtins();
    for (shell, file) in [
        ("bash", format!("bash/{name}")),
        ("zsh", format!("zsh/_{name}")),
        ("fish", format!("fish/{name}.fish")),
    ] {
        let mut text = Vec::new();
        let shell = shells.completer(shell).ok_or(io::ErrorKind::Unsupported)?;
        shell.write_registration(COMPLETE, name, name, name, &mut text)?;
        let file = folder.join(file);
        file.parent().map_or(Ok(()), fs::create_dir_all)?;
        fs::write(file, text)?;
    }
    Ok(())
}

/// The page with its examples as they were written: otherwise they are filled, as text is.
fn with_examples(page: &str) -> String {
    let Some((before, notes)) = page.split_once("\n.SH EXTRA\n") else {
        return page.to_owned();
    };
    let mut text = format!("{before}\n.SH NOTES\n");
    let mut within = false;
    for line in notes.lines() {
        if line.starts_with("  ") != within {
            within = !within;
            text.push_str(if within { ".nf\n" } else { ".fi\n" });
        }
        text.push_str(line);
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_command_has_a_page_and_each_shell_a_file() {
        let folder = tempfile::tempdir().unwrap();
        let shown = clap::Command::new("grab").about("Grab a token");
        let hidden = clap::Command::new("secret").hide(true);
        let command = clap::Command::new("mom").subcommands([shown, hidden]);
        let command = command.after_help("Examples:\n  mom grab   one\n  mom grab   two\nThe end.");
        write(&command, folder.path()).unwrap();
        for (file, part) in [
            ("man/mom.1", "grab"),
            ("man/mom-grab.1", "grab"),
            ("bash/mom", "MOM_COMPLETE=\"bash\""),
            ("zsh/_mom", "MOM_COMPLETE=\"zsh\""),
            ("fish/mom.fish", "MOM_COMPLETE=fish"),
        ] {
            let text = fs::read_to_string(folder.path().join(file)).unwrap();
            assert!(text.contains(part), "{file}: {text}");
        }
        let page = fs::read_to_string(folder.path().join("man/mom.1")).unwrap();
        let notes = "\n.SH NOTES\nExamples:\n.nf\n  mom grab   one\n  mom grab   two\n.fi\nThe end.\n";
        assert!(page.contains(notes), "{page}");
        assert!(!folder.path().join("man/mom-secret.1").exists());
    }
}
