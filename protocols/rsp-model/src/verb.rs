//! `mom rsp`: models of robots on the command line. It needs no hub.

use std::path::{Path, PathBuf};
use std::{fmt, fs, io};

use serde_json::{Value, json};

use crate::generate::{self, Ends};
use crate::model::{Direction, Model};

/// Check models of thin robots, and generate code and documents from them
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct VerbArgs {
    /// What to do
    #[command(subcommand)]
    pub task: RspTask,
}

/// What to do with a model.
#[derive(Debug, clap::Subcommand)]
pub enum RspTask {
    /// Check a model, and say its hash and the sizes of its packets
    #[command(after_help = CHECK)]
    Check {
        /// The model, a TOML file
        model: PathBuf,
    },
    /// Write code and documents that follow from a model
    #[command(after_help = GENERATE)]
    Generate {
        /// The model, a TOML file
        model: PathBuf,
        /// Write Rust for both ends
        #[arg(long, value_name = "FILE")]
        rust: Option<PathBuf>,
        /// For which ends the Rust is
        #[arg(long, value_enum, value_name = "ENDS", default_value_t = RustEnds::Both)]
        ends: RustEnds,
        /// Write a header of C99, for robots that are not in Rust
        #[arg(long, value_name = "FILE")]
        c: Option<PathBuf>,
        /// Write the library of the robot's end in C into this folder, for the header of C99
        #[arg(long, value_name = "DIR")]
        c_library: Option<PathBuf>,
        /// Write a page in Markdown that describes elements and packets
        #[arg(long, value_name = "FILE")]
        docs: Option<PathBuf>,
        /// Write all three into this folder, by the model's name
        #[arg(long, value_name = "DIR")]
        out: Option<PathBuf>,
    },
    /// Make a model of one that was drawn in UML
    #[command(after_help = IMPORT)]
    Import {
        /// The drawing, as XMI
        file: PathBuf,
        /// Write the model into this file and not to the standard output
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
    },
}

/// For which ends Rust is generated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum RustEnds {
    /// Both, with mom-rsp's feature `middle`
    Both,
    /// The middle, with the same feature
    Middle,
    /// The robot, without a library
    Robot,
}

const EXAMPLES: &str = "\
Examples:
  mom rsp check config/cubo.toml
  mom rsp generate config/cubo.toml --out generated
  mom rsp import robot.xmi --out robot.toml";

const CHECK: &str = "\
Says the model's hash, which both ends must have alike, and how large packets are when everything is in them; or all that is wrong,
each with line and column. Of an element whose kind, type or numbers are wrong it says the first mistake.

Examples:
  mom rsp check config/cubo.toml
  mom rsp check config/cubo.toml --json";

const GENERATE: &str = "\
Examples:
  mom rsp generate config/cubo.toml --rust src/cubo.rs
  mom rsp generate config/cubo.toml --rust src/cubo.rs --ends robot
  mom rsp generate config/cubo.toml --c firmware/cubo.h --c-library firmware
  mom rsp generate config/cubo.toml --out generated";

const IMPORT: &str = "\
Reads a class with the stereotype Robot whose attributes have stereotypes such as Effector, as Eclipse UML2 writes it.

Examples:
  mom rsp import robot.xmi
  mom rsp import robot.xmi --out robot.toml";

/// Why the verb failed.
#[derive(Debug)]
pub enum RspFailure {
    /// What went wrong, and what to do about it, where something can be done.
    Failed {
        /// What went wrong.
        text: String,
        /// What to do.
        hint: Option<String>,
    },
    /// What was found could not be told.
    Io(io::Error),
}

impl fmt::Display for RspFailure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            RspFailure::Failed { text, .. } => f.write_str(text),
            RspFailure::Io(error) => error.fmt(f),
        }
    }
}

impl std::error::Error for RspFailure {}

impl From<io::Error> for RspFailure {
    fn from(error: io::Error) -> RspFailure {
        RspFailure::Io(error)
    }
}

/// How a result is told: as JSON, and for people.
pub type Tell<'a> = &'a mut dyn FnMut(Value, String) -> io::Result<()>;

/// Makes the text of a file.
type Make = fn(&Model) -> String;

/// Does it.
///
/// # Errors
///
/// A file that cannot be read or written, a model in which something is wrong, with its place.
pub fn run(args: &VerbArgs, tell: Tell<'_>) -> Result<(), RspFailure> {
    match &args.task {
        RspTask::Check { model } => check(&read_model(model)?, tell),
        RspTask::Generate {
            model,
            rust,
            ends,
            c,
            c_library,
            docs,
            out,
        } => {
            let model = read_model(model)?;
            let in_folder = |ending: &str| {
                let folder = out.as_ref()?;
                Some(folder.join(format!("{}.{ending}", model.name())))
            };
            let makers: [(Option<PathBuf>, Make); 3] = [
                (rust.clone().or_else(|| in_folder("rs")), rust_for(*ends)),
                (c.clone().or_else(|| in_folder("h")), generate::c),
                (docs.clone().or_else(|| in_folder("md")), generate::markdown),
            ];
            if makers.iter().all(|(file, _)| file.is_none()) && c_library.is_none() {
                return Err(RspFailure::Failed {
                    text: "nothing is to be written".to_owned(),
                    hint: Some(
                        "name files with --rust, --c and --docs, or a folder with --out or --c-library"
                            .to_owned(),
                    ),
                });
            }
            for folder in [out, c_library].into_iter().flatten() {
                fs::create_dir_all(folder).map_err(|error| of_file("make", folder, &error))?;
            }
            for (file, make) in makers {
                if let Some(file) = file {
                    write(&file, &make(&model), tell)?;
                }
            }
            if let Some(folder) = c_library {
                for (name, text) in generate::library() {
                    write(&folder.join(name), text, tell)?;
                }
            }
            Ok(())
        }
        RspTask::Import { file, out } => {
            let model = Model::import_xmi(&text_of(file)?).map_err(|error| wrong(file, &error))?;
            let toml = model.to_toml();
            match out {
                Some(out) => write(out, &toml, tell),
                None => {
                    let line = toml.trim_end().to_owned();
                    Ok(tell(json!({ "toml": toml }), line)?)
                }
            }
        }
    }
}

fn rust_for(ends: RustEnds) -> Make {
    match ends {
        RustEnds::Both => generate::rust,
        RustEnds::Middle => |model| generate::rust_for(model, Ends::Middle),
        RustEnds::Robot => |model| generate::rust_for(model, Ends::Robot),
    }
}

/// A model, or all that is wrong in its file.
fn read_model(file: &Path) -> Result<Model, RspFailure> {
    let text = text_of(file)?;
    Model::read(&text).map_err(|first| match Model::faults(&text).as_slice() {
        several @ [_, _, ..] => {
            let lines: Vec<String> = several.iter().map(|fault| format!("\n  {fault}")).collect();
            let text = format!("{}: {} mistakes{}", file.display(), several.len(), lines.concat());
            RspFailure::Failed { text, hint: None }
        }
        _ => wrong(file, &first),
    })
}

fn text_of(file: &Path) -> Result<String, RspFailure> {
    fs::read_to_string(file).map_err(|error| of_file("read", file, &error))
}

fn wrong(file: &Path, error: &crate::ModelError) -> RspFailure {
    RspFailure::Failed {
        text: format!("{}: {error}", file.display()),
        hint: None,
    }
}

fn write(file: &Path, text: &str, tell: Tell<'_>) -> Result<(), RspFailure> {
    fs::write(file, text).map_err(|error| of_file("write", file, &error))?;
    let shown = file.display().to_string();
    Ok(tell(
        json!({ "file": shown, "bytes": text.len() }),
        format!("{shown}: {} lines", text.lines().count()),
    )?)
}

fn of_file(what: &str, file: &Path, error: &io::Error) -> RspFailure {
    RspFailure::Failed {
        text: format!("cannot {what} {}: {error}", file.display()),
        hint: None,
    }
}

fn check(model: &Model, tell: Tell<'_>) -> Result<(), RspFailure> {
    let hash: String = model.hash().iter().map(|byte| format!("{byte:02x}")).collect();
    let way = |direction| {
        let bytes = model.packet_size(direction);
        (bytes, bytes * 1000 / usize::from(model.period()))
    };
    let ((down, down_rate), (up, up_rate)) = (way(Direction::Down), way(Direction::Up));
    let json = json!({
        "name": model.name(),
        "id": model.id(),
        "hash": hash,
        "elements": model.elements().len(),
        "map": model.map_size(),
        "period": model.period(),
        "watchdog": model.watchdog(),
        "largest_packet": model.largest_packet(),
        "down": { "bytes": down, "bytes_per_second": down_rate },
        "up": { "bytes": up, "bytes_per_second": up_rate },
    });
    let (name, id, period) = (model.name(), model.id(), model.period());
    let lines = format!(
        "{name}  id {id} (0x{id:04x}), {} elements, map of {} B\nhash      {hash}\nperiod    {period} ms\n\
         to it     {down} B with everything in it, {down_rate} B a second\n\
         from it   {up} B with everything in it, {up_rate} B a second",
        model.elements().len(),
        model.map_size(),
    );
    Ok(tell(json, lines)?)
}
