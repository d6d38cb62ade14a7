//! Errors of a camera's settings.

/// A setting that the camera refuses.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SettingsError {
    /// A setting has a value that the camera cannot use.
    #[error("{setting} is {value}; it must be {limits}")]
    Setting {
        /// The name of the setting, as in [`CameraSettings`](crate::CameraSettings).
        setting: &'static str,
        /// The refused value.
        value: String,
        /// What is allowed, with its unit.
        limits: String,
    },
    /// There is no view of this name.
    #[error("there is no view {0:?}; the views are x, y, top, wrist and pan")]
    View(String),
}
