//! A real camera's frames and failures, where drawn cameras have their renderer.

use std::sync::Arc;
use std::time::Duration;

use mom_client::{Map, Parcel, Time, WireError};

use super::{ImageServer, REQUEST_REFUSED, ServerOptions};
use crate::shot::{Purpose, Shot, TakenFrame};
use crate::source::{Frame, FrameError, Sight, SourceError};
use crate::{Rendition, SettingsChange, SettingsError, Source, SourceUrl};

/// The message that a real camera gives no images, and why; once for each reason.
pub const CAMERA_ERROR: &str = "camera-error";
/// The message that it gives images again, which goes before the first of them.
pub const CAMERA_RECOVERED: &str = "camera-recovered";
/// What happens after a frame that cannot be decoded: the next one is.
const NEXT_FRAME: Duration = Duration::ZERO;

/// What is known of a real camera.
#[derive(Debug)]
pub(super) struct RealCamera {
    url: SourceUrl,
    rendition: Rendition,
    view: Arc<str>,
    /// The newest frame and what the robot had told when it came.
    newest: Option<Shot>,
    trouble: Option<Trouble>,
}

/// Why there are no pictures.
#[derive(Debug)]
struct Trouble {
    /// What is wrong, without what happens next.
    why: String,
    told: WireError,
}

impl RealCamera {
    /// The newest frame in the wanted form.
    pub(super) fn newest(&self) -> Option<Shot> {
        let mut shot = self.newest.clone()?;
        if let Some(taken) = &mut shot.taken_frame {
            taken.rendition = self.rendition;
        }
        Some(shot)
    }

    /// Whether the change makes another picture of a frame.
    pub(super) fn change(&mut self, change: &SettingsChange) -> Result<bool, SettingsError> {
        let rendition = self.rendition.with(change)?;
        let changed = rendition != self.rendition;
        self.rendition = rendition;
        Ok(changed)
    }

    /// The settings as far as they are known: what is not wanted is as the newest frame has it, without `quality`
    /// where frames go out as they came.
    pub(super) fn settings_map(&self) -> Map {
        let taken = self.newest.as_ref().and_then(|shot| shot.taken_frame.as_ref());
        let frame = taken.map(|taken| &*taken.frame);
        let (width, height) = self.rendition.size();
        let mut map = Map::new();
        if let Some(width) = width.or(frame.map(|frame| frame.width)) {
            map.set("width", width);
        }
        if let Some(height) = height.or(frame.map(|frame| frame.height)) {
            map.set("height", height);
        }
        if let Some(quality) = self.rendition.quality_used(frame) {
            map.set("quality", u32::from(quality));
        }
        if let Some(format) = self.rendition.format().or(frame.map(|frame| frame.format)) {
            map.set("format", format.name());
        }
        map.with("overlay", false)
    }
}

impl ImageServer {
    /// A server of a real camera's frames, without one yet. The settings of the options are not used: a frame goes out
    /// as it came, unless the source's own rendition or the token's owner wants it otherwise.
    ///
    /// # Errors
    /// As [`ImageServer::new`].
    pub fn real(options: ServerOptions, source: &Source) -> Result<ImageServer, SettingsError> {
        let real = RealCamera {
            url: source.url.clone(),
            rendition: source.rendition,
            view: options.channel.name().into(),
            newest: None,
            trouble: None,
        };
        let mut server = ImageServer::new(options)?;
        server.real = Some(real);
        Ok(server)
    }

    /// Takes what has become known of the real camera. `wall` is the time of day by the hub's clock.
    pub(crate) fn handle_sight(&mut self, sight: Sight, wall: Time, out: &mut Vec<Parcel>) {
        match sight {
            Sight::Waiting => {}
            Sight::Frame(frame) => self.take_frame(frame, wall),
            Sight::Failed { error, again } => self.handle_failed_source(&error, again, out),
        }
    }

    fn take_frame(&mut self, frame: Arc<Frame>, wall: Time) {
        let mut shot = self.shot_now(wall);
        let Some(real) = &mut self.real else { return };
        shot.taken_frame = Some(TakenFrame {
            frame,
            rendition: real.rendition,
            view: Arc::clone(&real.view),
        });
        real.newest = Some(shot);
        self.revision += 1;
    }

    fn handle_failed_source(&mut self, error: &SourceError, again: Duration, out: &mut Vec<Parcel>) {
        let Some(real) = &mut self.real else { return };
        real.newest = None;
        self.shown = self.revision;
        self.note_trouble(error, again, out);
    }

    /// Tells all what is wrong, unless they know.
    fn note_trouble(&mut self, error: &SourceError, again: Duration, out: &mut Vec<Parcel>) {
        let Some(real) = &mut self.real else { return };
        let (why, told) = (error.to_string(), error.tell(&real.url, again));
        let known = real.trouble.as_ref().is_some_and(|trouble| trouble.why == why);
        real.trouble = Some(Trouble {
            why,
            told: told.clone(),
        });
        if !known {
            out.push(self.message(CAMERA_ERROR, told.to_map()));
        }
    }

    /// A picture is there: whatever was wrong is over.
    pub(super) fn note_recovery(&mut self, out: &mut Vec<Parcel>) {
        let Some(real) = &mut self.real else { return };
        if real.trouble.take().is_some() {
            let text = format!("{} gives images again", real.url);
            out.push(self.message(CAMERA_RECOVERED, Map::new().with("text", text)));
        }
    }

    /// A frame could not be decoded.
    pub(super) fn refuse_picture(&mut self, error: &FrameError, purpose: &Purpose, out: &mut Vec<Parcel>) {
        self.note_trouble(&SourceError::Frame(error.clone()), NEXT_FRAME, out);
        self.refuse_purpose(purpose, out);
    }

    /// Tells those who asked for a picture why it is not sent.
    pub(super) fn refuse_purpose(&mut self, purpose: &Purpose, out: &mut Vec<Parcel>) {
        self.requests.extend(purpose.requests.iter().cloned());
        self.refuse_requests(out);
    }

    /// Whether there is a real camera and no frame of it.
    pub(super) fn has_no_frame(&self) -> bool {
        self.real.as_ref().is_some_and(|real| real.newest.is_none())
    }

    /// The same; who waits is told why, if that is known.
    pub(super) fn is_blind(&mut self, out: &mut Vec<Parcel>) -> bool {
        let blind = self.has_no_frame();
        if blind {
            self.refuse_requests(out);
        }
        blind
    }

    fn refuse_requests(&mut self, out: &mut Vec<Parcel>) {
        let trouble = self.real.as_ref().and_then(|real| real.trouble.as_ref());
        let Some(told) = trouble.map(|trouble| trouble.told.to_map()) else {
            return;
        };
        for request in std::mem::take(&mut self.requests) {
            out.push(self.answer(REQUEST_REFUSED, told.clone(), &request));
        }
    }
}

#[cfg(test)]
mod tests;
