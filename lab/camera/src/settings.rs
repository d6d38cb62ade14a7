//! Size, quality and format of the images, and their limits.

use std::fmt;
use std::ops::RangeInclusive;

use serde::{Deserialize, Serialize};

use crate::SettingsError;

/// Allowed widths in pixels.
pub const WIDTHS: RangeInclusive<u32> = 64..=1920;
/// Allowed heights in pixels.
pub const HEIGHTS: RangeInclusive<u32> = 48..=1080;
/// Allowed JPEG qualities.
pub const QUALITIES: RangeInclusive<u8> = 1..=100;

/// The settings of one camera (M37).
///
/// Deserializing checks the limits; a missing setting has its default.
///
/// ```
/// use mom_camera::{CameraSettings, SettingsChange};
///
/// let settings = CameraSettings::default();
/// let change = SettingsChange { quality: Some(50), ..SettingsChange::default() };
/// assert_eq!(settings.with(&change)?.quality, 50);
///
/// let change = SettingsChange { width: Some(5000), ..SettingsChange::default() };
/// let error = settings.with(&change).unwrap_err();
/// assert_eq!(error.to_string(), "width is 5000; it must be 64 to 1920 pixels");
/// # Ok::<(), mom_camera::SettingsError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "SettingsChange")]
pub struct CameraSettings {
    /// Width in pixels, 64 to 1920.
    pub width: u32,
    /// Height in pixels, 48 to 1080.
    pub height: u32,
    /// JPEG quality, 1 (smallest) to 100 (best). PNG is lossless and ignores it.
    pub quality: u8,
    /// The image format.
    pub format: Format,
    /// Whether the overlays are drawn into the image; beside it they always are.
    pub overlay: bool,
}

/// The image format.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Format {
    /// Small and lossy.
    #[default]
    Jpeg,
    /// Lossless.
    Png,
}

/// A change of settings: absent ones stay as they are.
///
/// The numbers are wider than those of [`CameraSettings`], so that a value outside the limits is refused with the
/// limits in words. A setting that does not exist is refused, because its sender expects it to do something.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SettingsChange {
    /// Width in pixels.
    pub width: Option<i64>,
    /// Height in pixels.
    pub height: Option<i64>,
    /// JPEG quality.
    pub quality: Option<i64>,
    /// `jpeg` or `png`.
    pub format: Option<String>,
    /// Whether the overlays are drawn into the image.
    pub overlay: Option<bool>,
}

impl Default for CameraSettings {
    fn default() -> Self {
        CameraSettings {
            width: 640,
            height: 480,
            quality: 80,
            format: Format::Jpeg,
            overlay: false,
        }
    }
}

impl CameraSettings {
    /// These settings with a change applied, or the first setting that is outside its limits.
    pub fn with(self, change: &SettingsChange) -> Result<CameraSettings, SettingsError> {
        Ok(CameraSettings {
            width: pick("width", change.width, self.width, &WIDTHS, " pixels")?,
            height: pick("height", change.height, self.height, &HEIGHTS, " pixels")?,
            quality: pick("quality", change.quality, self.quality, &QUALITIES, "")?,
            format: match &change.format {
                Some(name) => Format::from_name(name)?,
                None => self.format,
            },
            overlay: change.overlay.unwrap_or(self.overlay),
        })
    }

    /// Checks the limits of settings that were built field by field.
    pub fn check(self) -> Result<(), SettingsError> {
        let change = SettingsChange {
            width: Some(self.width.into()),
            height: Some(self.height.into()),
            quality: Some(self.quality.into()),
            ..SettingsChange::default()
        };
        self.with(&change).map(|_| ())
    }
}

impl Format {
    /// Its name in settings.
    pub fn name(self) -> &'static str {
        match self {
            Format::Jpeg => "jpeg",
            Format::Png => "png",
        }
    }

    /// The media type (RFC 2046, RFC 2083).
    pub fn media_type(self) -> &'static str {
        match self {
            Format::Jpeg => "image/jpeg",
            Format::Png => "image/png",
        }
    }

    /// The format of a name; `jpg` and upper case are understood.
    fn from_name(name: &str) -> Result<Format, SettingsError> {
        match name.to_ascii_lowercase().as_str() {
            "jpeg" | "jpg" => Ok(Format::Jpeg),
            "png" => Ok(Format::Png),
            _ => Err(SettingsError::Setting {
                setting: "format",
                value: format!("{name:?}"),
                limits: "jpeg or png".to_owned(),
            }),
        }
    }
}

impl TryFrom<SettingsChange> for CameraSettings {
    type Error = SettingsError;

    fn try_from(change: SettingsChange) -> Result<Self, SettingsError> {
        CameraSettings::default().with(&change)
    }
}

/// The requested value if there is one and it is within the limits.
fn pick<T>(
    setting: &'static str,
    wish: Option<i64>,
    now: T,
    limits: &RangeInclusive<T>,
    unit: &str,
) -> Result<T, SettingsError>
where
    T: Copy + PartialOrd + fmt::Display + TryFrom<i64>,
{
    let Some(wish) = wish else { return Ok(now) };
    T::try_from(wish)
        .ok()
        .filter(|value| limits.contains(value))
        .ok_or_else(|| SettingsError::Setting {
            setting,
            value: wish.to_string(),
            limits: format!("{} to {}{unit}", limits.start(), limits.end()),
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(json: &str, expected: Result<(u32, u32, u8, Format), &str>) {
        let got = serde_json::from_str::<CameraSettings>(json)
            .map(|s| (s.width, s.height, s.quality, s.format))
            .map_err(|error| error.to_string());
        match (got, expected) {
            (Ok(got), Ok(expected)) => assert_eq!(got, expected, "{json}"),
            (Err(got), Err(expected)) => assert!(got.starts_with(expected), "{json}: {got}"),
            (got, expected) => panic!("{json}: {got:?}, expected {expected:?}"),
        }
    }

    #[test]
    fn limits_are_kept_and_told() {
        use Format::{Jpeg, Png};
        check("{}", Ok((640, 480, 80, Jpeg)));
        check(
            r#"{"width":64,"height":48,"quality":1,"format":"png"}"#,
            Ok((64, 48, 1, Png)),
        );
        check(
            r#"{"width":1920,"height":1080,"quality":100,"format":"JPG"}"#,
            Ok((1920, 1080, 100, Jpeg)),
        );
        check(
            r#"{"width":63}"#,
            Err("width is 63; it must be 64 to 1920 pixels"),
        );
        check(
            r#"{"width":1921}"#,
            Err("width is 1921; it must be 64 to 1920 pixels"),
        );
        check(
            r#"{"height":47}"#,
            Err("height is 47; it must be 48 to 1080 pixels"),
        );
        check(
            r#"{"height":1081}"#,
            Err("height is 1081; it must be 48 to 1080 pixels"),
        );
        check(r#"{"quality":0}"#, Err("quality is 0; it must be 1 to 100"));
        check(r#"{"quality":101}"#, Err("quality is 101; it must be 1 to 100"));
        check(
            r#"{"quality":-9000000000}"#,
            Err("quality is -9000000000; it must be 1 to 100"),
        );
        check(
            r#"{"format":"gif"}"#,
            Err("format is \"gif\"; it must be jpeg or png"),
        );
        check(r#"{"qualty":50}"#, Err("unknown field `qualty`, expected one of"));
    }

    #[test]
    fn a_change_keeps_what_it_does_not_name() {
        let small = CameraSettings {
            width: 320,
            height: 240,
            quality: 30,
            format: Format::Png,
            overlay: true,
        };
        let change = SettingsChange {
            quality: Some(90),
            ..SettingsChange::default()
        };
        assert_eq!(small.with(&change), Ok(CameraSettings { quality: 90, ..small }));
        assert!(CameraSettings { width: 1, ..small }.check().is_err());
        assert_eq!(small.check(), Ok(()));
    }

    #[test]
    fn settings_go_out_and_in_again() {
        let settings = CameraSettings {
            width: 320,
            height: 240,
            quality: 30,
            format: Format::Png,
            overlay: true,
        };
        let json = serde_json::to_string(&settings).unwrap();
        assert_eq!(serde_json::from_str::<CameraSettings>(&json).unwrap(), settings);
    }
}
