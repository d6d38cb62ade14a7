//! A sound on its way to a robot: a block each 20 ms, whatever else is done (S13).

use mom_device::{DeviceError, DeviceTime, ErrorName};
use mom_rsp::{Refused, Sound};
use mom_sound::{Clip, Encoder, SoundError};

use crate::Simulacrum;

/// µs between two blocks.
const BLOCK: DeviceTime = Sound::PERIOD as DeviceTime;
/// µs that the robot keeps the first block back, so that it can play the others in time.
const PLAYOUT: DeviceTime = 100_000;

/// µs that blocks may be late before the sound is given up.
const PATIENCE: DeviceTime = 500_000;

/// A sound that is being played.
pub(crate) struct Playing {
    place: u8,
    encoder: Encoder,
    blocks: std::vec::IntoIter<Vec<i16>>,
    /// When the next block is due.
    next: DeviceTime,
}

impl std::fmt::Debug for Playing {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Playing")
            .field("place", &self.place)
            .field("next", &self.next)
            .finish_non_exhaustive()
    }
}

impl Playing {
    /// Begins a WAV file at an effector with this sound.
    pub(crate) fn begin(place: u8, sound: Sound, wav: &[u8], now: DeviceTime) -> Result<Playing, SoundError> {
        let clip = Clip::read(wav)?.at(sound.rate)?;
        let blocks: Vec<Vec<i16>> = clip.blocks(sound).collect();
        Ok(Playing {
            place,
            encoder: Encoder::new(sound)?,
            blocks: blocks.into_iter(),
            next: now,
        })
    }

    /// When it has been heard.
    pub(crate) fn end(&self) -> DeviceTime {
        let left = DeviceTime::try_from(self.blocks.len()).unwrap_or(DeviceTime::MAX);
        self.next
            .saturating_add(left.saturating_mul(BLOCK))
            .saturating_add(PLAYOUT)
    }

    /// When [`Playing::advance`] has to be called next; `None` once all is sent.
    pub(crate) fn next_wake(&self) -> Option<DeviceTime> {
        (self.blocks.len() > 0).then_some(self.next)
    }

    /// Sends the blocks that are due.
    ///
    /// # Errors
    ///
    /// `link` for a robot that takes no sound any more.
    pub(crate) fn advance(&mut self, robot: &Simulacrum, now: DeviceTime) -> Result<(), DeviceError> {
        if now.saturating_sub(self.next) > PATIENCE {
            // All that is late at once would be noise.
            self.blocks = Vec::new().into_iter();
            let text = format!(
                "the sound was ended: the program stood still for {} ms",
                (now - self.next) / 1000
            );
            return Err(DeviceError::new(ErrorName::Halted, text));
        }
        while self.next <= now {
            let Some(samples) = self.blocks.next() else {
                return Ok(());
            };
            self.next += BLOCK;
            let failed = |why: String| {
                let text = format!("{} does not take the sound: {why}", robot.name());
                DeviceError::new(ErrorName::Link, text)
            };
            let block = self
                .encoder
                .block(&samples)
                .map_err(|error| failed(error.to_string()))?;
            match robot.with(|middle| middle.send_blob(self.place, &block)) {
                // One block is not heard: a gap of 20 ms.
                Ok(_) | Err(Refused::Full) => {}
                Err(refused) => return Err(failed(refused.to_string())),
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::future::pending;
    use std::net::Ipv4Addr;
    use std::time::Duration;

    use mom_cubo::{Cubo, CuboHandle};
    use mom_rsp::middle::{Notice, Settings};
    use mom_rsp::robot;
    use mom_rsp_model::Model;
    use mom_wheels::Pose;
    use tokio::net::UdpSocket;
    use tokio::time::{sleep_until, timeout};

    use super::*;
    use crate::serve;

    const PATIENCE: Duration = Duration::from_secs(20);

    /// Over loopback, at the longest period too, each sample arrives as it was sent, in order and at the loudspeaker's own pace.
    #[tokio::test(flavor = "multi_thread")]
    async fn each_sample_of_a_sound_is_heard() {
        for period in [20, 200] {
            let near = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).await.unwrap();
            let far = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).await.unwrap();
            near.connect(far.local_addr().unwrap()).await.unwrap();
            let settings = robot::Settings {
                watchdog: 5000,
                ..robot::Settings::default()
            };
            let body = Cubo::new(Pose::new(2500.0, 2500.0, 0.0)).unwrap();
            let cubo = CuboHandle::new(body, settings).unwrap();
            tokio::spawn(mom_cubo::serve(far, cubo.clone(), pending()));
            let settings = Settings {
                silence: 5000,
                period,
                ..Settings::default()
            };
            let mirror = Simulacrum::new("cubo", Model::read(mom_cubo::MODEL).unwrap(), settings).unwrap();
            let mut notices = mirror.notices();
            tokio::spawn(serve(mirror.clone(), near, pending()));
            let up = async { while *notices.recv().await.unwrap() != Notice::Up {} };
            timeout(PATIENCE, up).await.expect("there is a session");

            let (place, speaker) = mirror.element("speaker").unwrap();
            let sound = speaker.sound.unwrap();
            let clip = Clip::tone(440.0, 0.6, sound.rate);
            let begin = tokio::time::Instant::now();
            let mut playing = Playing::begin(place, sound, &clip.to_wav().unwrap(), 0).unwrap();
            assert_eq!(playing.end(), 600_000 + PLAYOUT);
            while let Some(next) = playing.next_wake() {
                let at = begin + Duration::from_micros(u64::try_from(next).unwrap());
                sleep_until(at).await; // tidy: the pace of the sound
                // A machine that is busy for longer is not what this is about.
                playing.advance(&mirror, next).unwrap();
            }
            let all = async {
                while cubo.look(|body, _| body.doings.heard.len()) < clip.samples().len() {
                    tokio::task::yield_now().await;
                }
            };
            timeout(PATIENCE, all).await.expect("all of it is heard");
            let (heard, counts) = cubo.look(|body, _| (body.doings.heard.clone(), body.sound()));
            // On a busy machine blocks may be late, or come in larger heaps; what is heard is never wrong.
            if counts.lost + counts.late + counts.skipped == 0 {
                assert!(heard.starts_with(clip.samples()), "T = {period} ms");
            }
            assert!(counts.played >= 15 && counts.large == 0, "{counts:?}");
        }
    }
}
