//! CUBO's body (S25) as numbers: wheels on a floor, arms and head that follow their values, lips, a display, a loudspeaker, a microphone,
//! two buttons and six kinds of sensor.

use std::collections::VecDeque;
use std::f64::consts::TAU;

use mom_rsp::robot::{Outgoing, Played, Playout, PlayoutCounts};
use mom_rsp::typed::{Named as _, Unsent};
use mom_rsp::{FRAGMENT, Fragment, Sound};
use mom_sound::Decoder;
use mom_trace::Trace;
use mom_wheels::{Chassis, Driver, Floor, Motors, Pose, Power, Simulated, WheelTime, eye, switch};

use crate::End;
use crate::model::elements::{self, Joints, MessageRecorded, Pose as Place, Surroundings};
use crate::model::robot::{self, Body};
use crate::model::units::{DB, Deg, K, Lx, Mm, MmPerS, Percent, S};

/// Seconds after which arms and head have made 63 % of the way to their values.
const JOINT_LAG: f64 = 0.12;
/// µs between two pictures.
const PICTURE: WheelTime = 1_000_000;
/// µs for which a stored gesture lasts.
const GESTURE: WheelTime = 1_500_000;
/// mm beyond which the robot sees no obstacle.
const SIGHT: f64 = 2000.0;
/// Blocks of sound that can wait: three times as many as come together at the longest period.
const BLOCKS: usize = 32;
/// The most bytes of one.
const BLOCK: usize = elements::Speaker::SOUND.block();
/// dB of the room, of a sound at full scale, and of music that comes in packets, whose samples nobody looks at.
const QUIET: f64 = 30.0;
const LOUD: f64 = 80.0;
const MUSIC: f64 = 62.0;
/// Blobs that wait to be sent, of which the oldest is dropped.
const WAITING: usize = 2;

/// What a person does to the robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Touch {
    /// Presses the button that chooses a service.
    ServiceButton,
    /// Presses the message button: a message is recorded, and held.
    MessageButton,
    /// Touches its head for a second.
    Head,
}

/// The simulated body.
pub struct Cubo {
    now: WheelTime,
    wheels: Simulated,
    floor: Floor,
    /// What is wanted of the left and the right wheel.
    speeds: (MmPerS, MmPerS),
    /// Arms and head as they are wanted, and as they are.
    joints: Joints,
    posture: Joints,
    lips: Percent,
    /// The gesture that is played, and until when.
    gesture: Option<(u8, WheelTime)>,
    /// When it rests by itself, unless it is given a later time before.
    held: WheelTime,
    touched_until: WheelTime,
    picture_at: WheelTime,
    /// Blobs under way to the middle.
    outgoing: VecDeque<Outgoings>,
    pictures: u16,
    /// Blocks of sound until they are played.
    playout: Playout<BLOCK, BLOCKS>,
    decoder: Decoder,
    /// What had become of blocks before this sound.
    sounding: Option<PlayoutCounts>,
    /// When the loudspeaker takes the next block.
    speaker_at: WheelTime,
    /// How loud the loudspeaker is, dB.
    loudness: f64,
    /// What it heard of the loudspeaker last.
    echo: Vec<u8>,
    messages: u16,
    raised: VecDeque<Raised>,
    /// What it did, for tests and for its log.
    pub doings: Doings,
    /// Whether its camera is active.
    sees: bool,
    /// Where it is written where wheels, arms and head are.
    trace: Option<Trace>,
}

/// What the body did.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Doings {
    /// Gestures, in the order in which they were played.
    pub gestures: Vec<u8>,
    /// Blocks of sound that came in packets and were played at once (S26).
    pub blocks: u64,
    /// The sound that was played last, of those that came in blocks of their own.
    pub heard: Vec<i16>,
    /// Bytes of the picture on the display.
    pub display: usize,
    /// Sessions that began and ended.
    pub sessions: (u64, u64),
}

/// What a body looks like.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Glance {
    /// Where it is.
    pub pose: Pose,
    /// Whether its wheels turn.
    pub turns: bool,
    /// Where arms and head are.
    pub posture: Joints,
    /// How far its lips are open.
    pub lips: Percent,
    /// The gesture that is played.
    pub gesture: Option<u8>,
    /// Whether a sound is played, or waits to be.
    pub sounds: bool,
}

/// An event that is to be told.
enum Raised {
    Service,
    Message,
    Recorded(MessageRecorded),
}

/// A blob that is sent in parts.
struct Outgoings {
    element: u8,
    blob: u16,
    bytes: Vec<u8>,
    sent: usize,
}

impl Cubo {
    /// A robot that stands there, on a floor of 5 m by 5 m.
    ///
    /// # Errors
    ///
    /// A place that is not on the floor; a codec that this program was built without.
    pub fn new(pose: Pose) -> anyhow::Result<Self> {
        let floor = Floor::ARENA;
        Ok(Self {
            now: 0,
            wheels: Simulated::new(Chassis::CUBO, Power::LINUXBOT, floor, pose)?,
            floor,
            speeds: Default::default(),
            joints: Joints::default(),
            posture: Joints::default(),
            lips: Percent::default(),
            gesture: None,
            held: WheelTime::MAX,
            touched_until: 0,
            picture_at: 0,
            outgoing: VecDeque::new(),
            pictures: 0,
            playout: Playout::default(),
            decoder: Decoder::new(elements::Speaker::SOUND)?,
            sounding: None,
            speaker_at: 0,
            loudness: QUIET,
            echo: Vec::new(),
            messages: 0,
            raised: VecDeque::new(),
            doings: Doings::default(),
            sees: true,
            trace: None,
        })
    }

    /// A person touches it.
    pub fn touch(&mut self, touch: Touch) {
        match touch {
            Touch::ServiceButton => self.raised.push_back(Raised::Service),
            Touch::MessageButton => {
                self.messages = self.messages.wrapping_add(1);
                self.raised.push_back(Raised::Message);
                self.raised.push_back(Raised::Recorded(MessageRecorded {
                    number: self.messages,
                    length: S(f64::from(10 + self.messages % 50) / 10.0),
                }));
            }
            Touch::Head => self.touched_until = self.now + 1_000_000,
        }
    }

    /// Has it be written from now on where it is: x and y in mm, where it looks, and the angles of left arm, right arm and head in degrees.
    pub fn trace(&mut self, trace: Trace) {
        self.trace = Some(trace);
    }

    /// Has it rest by itself at `until`, whatever it is told by then, unless a later time is given before; [`WheelTime::MAX`] is never. It
    /// is what the hardware does whose program stands still.
    pub fn hold(&mut self, until: WheelTime) {
        self.held = until;
        // Simulated wheels take every time.
        let _ = self.wheels.hold(until, self.now);
    }

    /// Lets time pass until `now`, µs.
    pub fn advance(&mut self, now: WheelTime) {
        if let Some(mut trace) = self.trace.take() {
            trace.until(now, |at| {
                self.live(at);
                let pose = self.wheels.pose(self.now);
                let Joints {
                    left_arm,
                    right_arm,
                    head_tilt,
                } = self.posture;
                [pose.x, pose.y, pose.heading, left_arm.0, right_arm.0, head_tilt.0]
            });
            self.trace = Some(trace);
        }
        self.live(now);
    }

    /// As [`advance`](Self::advance), and writes nothing.
    fn live(&mut self, now: WheelTime) {
        if now >= self.held {
            self.pass(self.held);
            self.rest();
        }
        self.pass(now);
    }

    /// What it does without anybody's word: its wheels stop, arms, head and lips go back, gesture and sound end.
    fn rest(&mut self) {
        self.hold(WheelTime::MAX);
        (self.speeds, self.joints, self.lips) = Default::default();
        self.set_wheels();
        self.gesture = None;
        self.playout.silence();
    }

    fn pass(&mut self, now: WheelTime) {
        // It moves on from the end of a gesture as from each other moment.
        if let Some((_, until)) = self.gesture
            && now >= until
        {
            self.follow(until);
            self.gesture = None;
        }
        self.follow(now);
    }

    /// Arms and head follow what is wanted of them until `now`.
    fn follow(&mut self, now: WheelTime) {
        let seconds = (now - self.now).max(0) as f64 / 1e6;
        self.now = self.now.max(now);
        self.play();
        let share = 1.0 - (-seconds / JOINT_LAG).exp();
        let wanted = self.wanted_posture();
        let moved = |is: Deg, wanted: Deg| Deg(is.0 + (wanted.0 - is.0) * share);
        self.posture = Joints {
            left_arm: moved(self.posture.left_arm, wanted.left_arm),
            right_arm: moved(self.posture.right_arm, wanted.right_arm),
            head_tilt: moved(self.posture.head_tilt, wanted.head_tilt),
        };
    }

    /// Plays what is due: the loudspeaker takes a block each 20 ms.
    fn play(&mut self) {
        let period = Sound::PERIOD as WheelTime;
        while self.speaker_at <= self.now {
            let at = u64::try_from(self.speaker_at).unwrap_or(0);
            self.speaker_at += period;
            if self.playout.is_silent() {
                self.loudness = QUIET;
                if let Some(before) = self.sounding.take() {
                    let counts = self.playout.counts();
                    tracing::info!(
                        blocks = counts.played - before.played,
                        lost = counts.lost - before.lost,
                        late = counts.late - before.late,
                        "a sound was played"
                    );
                }
                self.speaker_at = self.speaker_at.max(self.now + 1);
                continue;
            }
            let samples = match self.playout.take(at) {
                Some(Played::Block(bytes)) => self.decoder.block(bytes),
                Some(Played::Lost) => self.decoder.lost(),
                // It waits for more.
                None => continue,
            };
            self.loudness = mom_sound::level(&samples).map_or(QUIET, |level| (LOUD + level).max(QUIET));
            let bytes: Vec<u8> = samples.iter().copied().flat_map(i16::to_le_bytes).collect();
            self.hear(&bytes);
            self.doings.heard.extend(samples);
            // The last ten seconds.
            let most = 10 * elements::Speaker::SOUND.rate as usize;
            let over = self.doings.heard.len().saturating_sub(most);
            self.doings.heard.drain(..over);
        }
    }

    /// The microphone hears the loudspeaker: a third of the samples.
    fn hear(&mut self, samples: &[u8]) {
        self.echo = samples
            .chunks_exact(2)
            .step_by(3)
            .flatten()
            .copied()
            .take(640)
            .collect();
    }

    /// What became of blocks of sound.
    #[must_use]
    pub fn sound(&self) -> PlayoutCounts {
        self.playout.counts()
    }

    /// Where arms and head are to be: the gesture that is played takes the arms.
    fn wanted_posture(&self) -> Joints {
        let mut joints = self.joints;
        if let Some((number, until)) = self.gesture {
            let phase = (until - self.now) as f64 / GESTURE as f64;
            let wave = 30.0 * (phase * TAU * f64::from(1 + number % 4)).sin();
            if number % 3 != 1 {
                joints.left_arm = Deg(45.0 + wave);
            }
            if number % 3 != 0 {
                joints.right_arm = Deg(45.0 - wave);
            }
        }
        joints
    }

    /// Tells its end what it senses and what has happened.
    pub fn tell(&mut self, end: &mut End) {
        self.playout.set_period(end.period());
        let sensors = self.wheels.sensors(self.now).ok();
        let pose = sensors.and_then(|sensors| sensors.pose).unwrap_or_default();
        let switches = sensors.map_or(0, |sensors| sensors.switches);
        let touched = self.now < self.touched_until || switches & switch::FRONT != 0;
        let surroundings = Surroundings {
            distance: Mm(self.distance(pose)),
            luminance: Lx(800.0),
            sound_level: DB(self.loudness),
            touch: touched.into(),
            temperature: K(296.0),
            battery: Percent(sensors.map_or(0, |sensors| sensors.battery).into()),
        };
        let place = Place {
            x: Mm(pose.x),
            y: Mm(pose.y),
            heading: Deg(pose.heading),
        };
        told(robot::tell_pose(end, place));
        told(robot::tell_posture(end, self.posture));
        told(robot::tell_surroundings(end, surroundings));
        // It hears itself.
        if !self.echo.is_empty() {
            told(robot::tell_microphone(end, &std::mem::take(&mut self.echo)));
        }
        while let Some(event) = self.raised.pop_front() {
            match event {
                Raised::Service => told(robot::raise_service_button(end)),
                Raised::Message => told(robot::raise_message_button(end)),
                Raised::Recorded(message) => told(robot::raise_message_recorded(end, message)),
            }
        }
        if self.sees && end.is_up() && self.now >= self.picture_at {
            self.picture_at = self.now + PICTURE;
            if let Some(picture) = self.picture(pose) {
                self.pictures = self.pictures.wrapping_add(1);
                self.send_blob(elements::Camera::PLACE, self.pictures, picture);
            }
        }
    }

    /// What it looks like now.
    pub fn glance(&mut self) -> Glance {
        let (turns, pose) = self.motion();
        Glance {
            pose,
            turns,
            posture: self.posture,
            lips: self.lips,
            gesture: self.gesture.map(|(number, _)| number),
            sounds: !self.playout.is_silent(),
        }
    }

    /// Whether its wheels turn, and where it is.
    pub fn motion(&mut self) -> (bool, Pose) {
        let pose = self
            .wheels
            .sensors(self.now)
            .ok()
            .and_then(|sensors| sensors.pose);
        (self.speeds != Default::default(), pose.unwrap_or_default())
    }

    /// mm to the nearest wall ahead.
    fn distance(&self, pose: Pose) -> f64 {
        let (sin, cos) = pose.heading.to_radians().sin_cos();
        let to = |at: f64, along: f64, end: f64| match along {
            along if along > 1e-9 => (end - at) / along,
            along if along < -1e-9 => -at / along,
            _ => f64::INFINITY,
        };
        let ahead = to(pose.x, cos, self.floor.width).min(to(pose.y, sin, self.floor.depth));
        (ahead - Chassis::CUBO.radius).clamp(0.0, SIGHT)
    }

    fn picture(&self, pose: Pose) -> Option<Vec<u8>> {
        let pixels = eye::draw(self.floor, pose);
        let mut jpeg = Vec::new();
        let mut encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(&mut jpeg, 60);
        let drawn = encoder.encode(&pixels, eye::WIDTH, eye::HEIGHT, image::ExtendedColorType::Rgb8);
        drawn.ok().map(|()| jpeg)
    }

    fn send_blob(&mut self, element: u8, blob: u16, bytes: Vec<u8>) {
        if self.outgoing.len() >= WAITING {
            self.outgoing.pop_front();
        }
        self.outgoing.push_back(Outgoings {
            element,
            blob,
            bytes,
            sent: 0,
        });
    }

    fn set_wheels(&mut self) {
        let full = Chassis::CUBO.full_speed;
        let per_mille = |speed: MmPerS| (speed.0 / full * 1000.0).round() as i16;
        let (left, right) = (per_mille(self.speeds.0), per_mille(self.speeds.1));
        // What cannot be set is seen in where it is.
        let _ = self.wheels.set_motors(Motors::new(left, right), self.now);
    }
}

/// One that is switched off is not told, and an event without a session is nobody's.
fn told(result: Result<(), impl Into<Unsent>>) {
    if let Err(why) = result {
        let why: Unsent = why.into();
        tracing::trace!(?why, "not told");
    }
}

impl Body for Cubo {
    fn random(&mut self, bytes: &mut [u8]) {
        if getrandom::fill(bytes).is_err() {
            tracing::error!("the system gives no random numbers");
        }
    }

    fn set_left_wheel(&mut self, value: MmPerS) {
        self.speeds.0 = value;
        self.set_wheels();
    }

    fn set_right_wheel(&mut self, value: MmPerS) {
        self.speeds.1 = value;
        self.set_wheels();
    }

    fn set_joints(&mut self, value: Joints) {
        self.joints = value;
    }

    fn set_lips(&mut self, value: Percent) {
        self.lips = value;
    }

    /// Plays a block of sound that was in a packet.
    fn set_speaker(&mut self, bytes: &[u8]) {
        if bytes.is_empty() {
            return;
        }
        self.doings.blocks += 1;
        self.loudness = MUSIC;
        self.hear(bytes);
    }

    fn run_gesture(&mut self, value: u8) {
        self.gesture = Some((value, self.now + GESTURE));
        self.doings.gestures.push(value);
    }

    /// Sound is played; the display shows its newest picture, and what that looks like is not simulated.
    fn fragment(&mut self, fragment: Fragment<'_>) {
        if fragment.element == elements::Speaker::PLACE {
            if self.playout.is_silent() {
                self.doings.heard.clear();
                self.sounding = Some(self.playout.counts());
            }
            self.playout.push(u64::try_from(self.now).unwrap_or(0), &fragment);
        }
        if fragment.element == elements::Lcd::PLACE {
            self.doings.display = usize::try_from(fragment.total).unwrap_or(0);
        }
    }

    fn next_fragment(&mut self, into: &mut [u8]) -> Option<Outgoing> {
        let blob = self.outgoing.front_mut()?;
        let rest = blob.bytes.get(blob.sent..)?;
        let part = rest.get(..FRAGMENT.min(rest.len()))?;
        into.get_mut(..part.len())?.copy_from_slice(part);
        let outgoing = Outgoing {
            element: blob.element,
            blob: blob.blob,
            offset: u32::try_from(blob.sent).ok()?,
            total: u32::try_from(blob.bytes.len()).ok()?,
            len: u16::try_from(part.len()).ok()?,
        };
        blob.sent += part.len();
        if blob.sent == blob.bytes.len() {
            self.outgoing.pop_front();
        }
        Some(outgoing)
    }

    fn active(&mut self, element: u8, active: bool) {
        match element {
            elements::Camera::PLACE => self.sees = active,
            elements::Gesture::PLACE if !active => self.gesture = None,
            elements::Speaker::PLACE if !active => self.playout.silence(),
            _ => {}
        }
    }

    fn session(&mut self, up: bool) {
        match up {
            true => self.doings.sessions.0 += 1,
            false => {
                self.doings.sessions.1 += 1;
                self.outgoing.clear();
                self.rest();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn driving() -> Cubo {
        let mut cubo = Cubo::new(Pose::new(1000.0, 2500.0, 0.0)).unwrap();
        cubo.advance(0);
        cubo.hold(2_000_000);
        cubo.set_left_wheel(MmPerS(200.0));
        cubo.set_right_wheel(MmPerS(200.0));
        cubo.set_lips(Percent(50.0));
        cubo.run_gesture(2);
        cubo
    }

    /// A program that stood still looks at its body again: that has rested since its time, as hardware has.
    #[test]
    fn a_body_rests_when_its_time_has_passed_whenever_that_is_looked_at() {
        let (mut looked_at, mut frozen) = (driving(), driving());
        for ms in 1..=3000 {
            looked_at.advance(ms * 1000);
        }
        for body in [&mut looked_at, &mut frozen] {
            body.advance(60_000_000);
            let glance = body.glance();
            assert!((glance.pose.x - 1400.0).abs() < 1.0, "{glance:?}");
            assert!(!glance.turns && glance.gesture.is_none() && glance.lips.0 == 0.0);
            assert!(glance.posture.left_arm.0.abs() < 0.1, "{glance:?}");
        }
    }

    /// A later time that is given before keeps it going.
    #[test]
    fn a_body_that_is_held_on_goes_on() {
        let mut cubo = driving();
        for seconds in 1..=5 {
            cubo.advance(seconds * 1_000_000);
            cubo.hold(seconds * 1_000_000 + 2_000_000);
        }
        assert!(cubo.glance().turns);
        let way = cubo.glance().pose.x - 1000.0;
        assert!((900.0..1000.0).contains(&way), "{way} mm in 5 s");
    }
}
