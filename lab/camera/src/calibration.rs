//! A measured projection matrix, which takes the place of the camera's own (M55).

use std::fs::{self, File};
use std::future::pending;
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};

use mom_client::{Code, Map, Parcel, Time, Value, WireError};
use nalgebra::{Matrix3x4, Vector4};
use serde::{Deserialize, Serialize};
use tokio::task::{JoinHandle, spawn_blocking};

use crate::View;

/// The sizes of images that a matrix may be for, pixels: a real camera's may be larger than those that are drawn.
const SIZES: std::ops::RangeInclusive<u32> = 1..=16384;

/// A measured matrix, who measured it, and how well.
///
/// It is for images of one size; images of others get it [scaled](Calibration::scaled), as the view itself is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Calibration {
    /// The 3×4 matrix, row by row, mm to pixels, scaled so that the third component of a product is the depth in mm.
    pub matrix: [f64; 12],
    /// The width of the images that it was measured in, pixels.
    pub width: u32,
    /// Their height, pixels.
    pub height: u32,
    /// The root of the mean squared distance between measured and computed pixels.
    pub rms: f64,
    /// In how many poses it was measured.
    pub poses: u32,
    /// The peer that measured it.
    pub by: String,
    /// When it was told to the camera.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time: Option<Time>,
}

/// What a `calibration` message says. The numbers are wider than those of [`Calibration`], so that a wrong one is refused
/// in words.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct MeasuredMatrix {
    matrix: Vec<f64>,
    width: i64,
    height: i64,
    rms: f64,
    poses: i64,
}

impl Calibration {
    /// Reads and checks a message; the error says what is wrong with it.
    pub(crate) fn of(parcel: &Parcel, view: View) -> Result<Calibration, WireError> {
        if let Some(motion) = view.motion() {
            let text =
                format!("{motion}, so that no one matrix is right; it computes its own for each image");
            return Err(bad(text));
        }
        let content = parcel
            .content
            .as_ref()
            .ok_or_else(|| bad("there is no matrix in it"))?;
        let told: MeasuredMatrix = content.read()?;
        let numbers: [f64; 12] = told.matrix.try_into().map_err(|given: Vec<f64>| {
            bad(format!(
                "the matrix has {} numbers; it must have 12, row by row",
                given.len()
            ))
        })?;
        let pixels = |name: &str, value: i64| {
            let fits = u32::try_from(value).ok().filter(|value| SIZES.contains(value));
            fits.ok_or_else(|| {
                bad(format!(
                    "{name} is {value}; it must be {} to {} pixels",
                    SIZES.start(),
                    SIZES.end()
                ))
            })
        };
        Calibration {
            matrix: numbers,
            width: pixels("width", told.width)?,
            height: pixels("height", told.height)?,
            rms: told.rms,
            poses: u32::try_from(told.poses)
                .map_err(|_| bad(format!("poses is {}; it must be the number of poses", told.poses)))?,
            by: parcel.sender.as_deref().unwrap_or_default().to_owned(),
            time: parcel.timestamp,
        }
        .checked()
    }

    /// The same with the matrix at its own scale, if it is that of a camera that looks at the table.
    fn checked(mut self) -> Result<Calibration, WireError> {
        if !(self.rms.is_finite() && self.rms >= 0.0) {
            return Err(bad(format!("rms is {}; it must be a number of pixels", self.rms)));
        }
        if !self.matrix.iter().all(|number| number.is_finite()) {
            return Err(bad("a number of the matrix is not finite"));
        }
        let matrix = Matrix3x4::from_row_slice(&self.matrix);
        let left = matrix.fixed_columns::<3>(0);
        let (rows, size) = ([0, 1, 2].map(|row| left.row(row).norm()), left.determinant());
        // How far the three rows are from lying in a plane, whatever their lengths.
        let volume = size.abs() / rows.iter().product::<f64>();
        if !(volume.is_finite() && volume > 1e-9) {
            return Err(bad(
                "the matrix is degenerate: it maps the whole world onto a line",
            ));
        }
        // Right-handed, so that the third component is the depth.
        let matrix = matrix * (size.signum() / rows[2]);
        let [u, v, depth]: [f64; 3] = (matrix * Vector4::new(0.0, 0.0, 0.0, 1.0)).into();
        if depth <= 0.0 {
            return Err(bad("the matrix has the table behind the camera"));
        }
        let (u, v) = (u / depth, v / depth);
        let inside = |at: f64, size: u32| (0.0..f64::from(size)).contains(&at);
        if !(inside(u, self.width) && inside(v, self.height)) {
            let (width, height) = (self.width, self.height);
            return Err(bad(format!(
                "the matrix maps the table's middle to {u:.0} {v:.0}, outside the image of {width}x{height}"
            )));
        }
        self.matrix = row_by_row(&matrix);
        Ok(self)
    }

    /// The matrix for images of this size: the image shows the same around its middle, scaled as
    /// [`View::camera`] does.
    #[must_use]
    pub fn scaled(&self, width: u32, height: u32) -> [f64; 12] {
        let across = |width: u32, height: u32| f64::from(width).min(f64::from(height) * 4.0 / 3.0);
        let scale = across(width, height) / across(self.width, self.height);
        let middle = |old: u32, new: u32| f64::from(new) / 2.0 - scale * f64::from(old) / 2.0;
        let matrix = Matrix3x4::from_row_slice(&self.matrix);
        let depth = matrix.row(2).into_owned();
        let mut scaled = matrix;
        scaled.set_row(0, &(matrix.row(0) * scale + depth * middle(self.width, width)));
        scaled.set_row(1, &(matrix.row(1) * scale + depth * middle(self.height, height)));
        row_by_row(&scaled)
    }

    /// What is told of it beside an image.
    pub(crate) fn facts(&self) -> Map {
        let map = Map::new()
            .with("rms", Value::Double(self.rms))
            .with("poses", self.poses)
            .with("by", self.by.as_str());
        match self.time {
            Some(time) => map.with("time", time),
            None => map,
        }
    }

    /// The whole, as it is told to all.
    pub(crate) fn to_map(&self) -> Map {
        let matrix: Vec<Value> = self.matrix.into_iter().map(Value::Double).collect();
        let map = Map::new()
            .with("matrix", matrix)
            .with("width", self.width)
            .with("height", self.height);
        self.facts()
            .into_iter()
            .fold(map, |map, (key, value)| map.with(&key, value))
    }
}

fn row_by_row(matrix: &Matrix3x4<f64>) -> [f64; 12] {
    std::array::from_fn(|i| matrix[(i / 4, i % 4)])
}

fn bad(text: impl Into<String>) -> WireError {
    WireError::new(Code::BAD_CONTENT, text.into())
}

/// The file that keeps a camera's calibration over restarts (JSON).
#[derive(Debug)]
pub(crate) struct CalibrationFile {
    path: PathBuf,
    /// What stands in it.
    kept: Option<Calibration>,
}

impl CalibrationFile {
    /// Reads it, if it is there.
    pub(crate) fn open(path: &Path, view: View) -> Result<CalibrationFile, String> {
        let wrong = |error: &dyn std::fmt::Display| format!("the calibration in {}: {error}", path.display());
        if let Some(motion) = view.motion() {
            return Err(wrong(&format!("{motion} and has none")));
        }
        let kept = match fs::read(path) {
            Ok(bytes) => {
                let read: Calibration = serde_json::from_slice(&bytes).map_err(|error| wrong(&error))?;
                if !(SIZES.contains(&read.width) && SIZES.contains(&read.height)) {
                    return Err(wrong(&"its size is not that of a camera's image"));
                }
                Some(read.checked().map_err(|error| wrong(&error.text))?)
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => None,
            Err(error) => return Err(wrong(&error)),
        };
        Ok(CalibrationFile {
            path: path.to_owned(),
            kept,
        })
    }

    /// How to write what has changed, if anything has. It waits for the disk.
    fn keep(
        &mut self,
        calibration: Option<&Calibration>,
    ) -> Option<impl FnOnce() -> io::Result<()> + Send + use<>> {
        let calibration = calibration.filter(|new| self.kept.as_ref() != Some(new))?;
        // Not tried again before the next change, if it fails.
        self.kept = Some(calibration.clone());
        let (calibration, path) = (calibration.clone(), self.path.clone());
        Some(move || write(&calibration, &path))
    }
}

/// A reader at any time, or after a crash, finds the old or the new whole.
fn write(calibration: &Calibration, path: &Path) -> io::Result<()> {
    let mut name = path.to_owned().into_os_string();
    name.push(".new");
    let beside = PathBuf::from(name);
    let mut file = File::create(&beside)?;
    file.write_all(&serde_json::to_vec_pretty(calibration)?)?;
    file.sync_all()?;
    fs::rename(&beside, path)
}

/// Writes the file on a thread of its own, one calibration after the other, so that nothing else waits for the disk.
#[derive(Debug)]
pub(crate) struct CalibrationKeeper {
    /// None = nothing is kept.
    file: Option<CalibrationFile>,
    writing: Option<JoinHandle<io::Result<()>>>,
}

impl CalibrationKeeper {
    pub(crate) fn new(file: Option<CalibrationFile>) -> CalibrationKeeper {
        CalibrationKeeper { file, writing: None }
    }

    /// What was kept when the file was opened, or is to be since then.
    pub(crate) fn kept(&self) -> Option<&Calibration> {
        self.file.as_ref()?.kept.as_ref()
    }

    /// Begins to write what has changed, unless it is writing: then it is to be called again once that is done.
    pub(crate) fn keep(&mut self, calibration: Option<&Calibration>) {
        if self.writing.is_none()
            && let Some(write) = self.file.as_mut().and_then(|file| file.keep(calibration))
        {
            self.writing = Some(spawn_blocking(write));
        }
    }

    /// Waits until what is being written is written; forever if nothing is. Cancel safe.
    pub(crate) async fn written(&mut self) {
        let Some(writing) = &mut self.writing else {
            return pending().await;
        };
        let written = writing.await.map_err(io::Error::from).flatten();
        self.writing = None;
        if let Err(error) = written {
            tracing::error!(%error, "the calibration is in use, but could not be kept");
        }
    }

    /// Writes to the end what has changed.
    pub(crate) async fn finish(mut self, calibration: Option<&Calibration>) {
        loop {
            self.keep(calibration);
            if self.writing.is_none() {
                return;
            }
            self.written().await;
        }
    }
}

#[cfg(test)]
mod tests {
    use mom_client::Family;

    use super::*;
    use crate::DrawnPose;

    fn matrix_of(view: View, width: u32, height: u32) -> [f64; 12] {
        view.camera(&DrawnPose::default(), width, height).matrix()
    }

    fn told(matrix: &[f64], width: i64, height: i64) -> Result<Calibration, WireError> {
        let numbers: Vec<Value> = matrix.iter().map(|number| Value::Double(*number)).collect();
        let content = Map::new()
            .with("matrix", numbers)
            .with("width", width)
            .with("height", height)
            .with("rms", Value::Double(0.1))
            .with("poses", 20);
        let mut parcel = Parcel::new(Family::Message, "calibration").content(content);
        parcel.sender = Some("alice".into());
        Calibration::of(&parcel, View::X)
    }

    fn near(a: &[f64; 12], b: &[f64; 12]) -> bool {
        a.iter()
            .zip(b)
            .all(|(a, b)| (a - b).abs() < 1e-6 * b.abs().max(1.0))
    }

    #[test]
    fn a_matrix_is_scaled_as_the_view_is() {
        let sizes = [
            (640, 480),
            (320, 240),
            (1280, 720),
            (480, 640),
            (64, 48),
            (1920, 1080),
            // More than is drawn: a real camera's.
            (3840, 2160),
        ];
        for view in [View::X, View::Y, View::Top] {
            for (width, height) in sizes {
                let given = matrix_of(view, width, height);
                let calibration = told(&given, width.into(), height.into()).expect("the view's own");
                for (width, height) in sizes {
                    let scaled = calibration.scaled(width, height);
                    assert!(
                        near(&scaled, &matrix_of(view, width, height)),
                        "{view} at {width}x{height}"
                    );
                }
                // At another scale, of either sign, it is the same.
                let doubled = told(&given.map(|number| -2.0 * number), width.into(), height.into());
                assert!(near(
                    &doubled.expect("the same camera").matrix,
                    &calibration.matrix
                ));
            }
        }
    }

    #[test]
    fn what_is_no_camera_of_this_table_is_refused() {
        let good = matrix_of(View::X, 640, 480);
        let changed = |change: &dyn Fn(&mut [f64; 12])| {
            let mut matrix = good;
            change(&mut matrix);
            told(&matrix, 640, 480).expect_err("refused").text
        };
        for (text, words) in [
            (changed(&|m| m[5] = f64::NAN), "not finite"),
            (changed(&|m| m[3] = f64::INFINITY), "not finite"),
            (changed(&|m| *m = [0.0; 12]), "degenerate"),
            (changed(&|m| m.copy_within(0..4, 4)), "degenerate"),
            (
                changed(&|m| [m[3], m[7], m[11]] = [-m[3], -m[7], -m[11]]),
                "behind the camera",
            ),
            (changed(&|m| m[3] += 1e6), "outside the image of 640x480"),
            (
                told(&good[..11], 640, 480).expect_err("refused").text,
                "has 11 numbers; it must have 12",
            ),
            (
                told(&good, 0, 480).expect_err("refused").text,
                "width is 0; it must be 1 to 16384 pixels",
            ),
            (
                told(&good, 640, -1).expect_err("refused").text,
                "height is -1; it must be 1 to 16384 pixels",
            ),
        ] {
            assert!(text.contains(words), "{text:?} lacks {words:?}");
        }
    }

    #[tokio::test]
    async fn a_file_keeps_it_and_a_broken_one_is_told() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("x.json");
        let open = || CalibrationFile::open(&path, View::X);
        let mut keeper = CalibrationKeeper::new(Some(open().expect("it is not there yet")));
        assert_eq!(keeper.kept(), None);
        let first = told(&matrix_of(View::X, 640, 480), 640, 480).expect("good");
        keeper.keep(Some(&first));
        // The second comes while the first is written.
        let measured = told(&matrix_of(View::X, 3840, 2160), 3840, 2160).expect("good");
        keeper.keep(Some(&measured));
        keeper.written().await;
        assert_eq!(open().expect("read").kept, Some(first));
        keeper.finish(Some(&measured)).await;
        assert_eq!(open().expect("read").kept, Some(measured));
        assert_eq!(
            fs::read_dir(folder.path()).expect("a folder").count(),
            1,
            "nothing lies beside it"
        );
        let wrist = CalibrationFile::open(&path, View::Wrist).expect_err("it has none");
        assert!(wrist.contains("moves with the arm"), "{wrist}");
        fs::write(&path, b"{\"matrix\": 7}").expect("written");
        let broken = CalibrationFile::open(&path, View::X).expect_err("broken");
        assert!(broken.contains("x.json") && broken.contains("line 1"), "{broken}");
    }
}
