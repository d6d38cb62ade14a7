//! The calibration agent: hears in its channel which camera is to be calibrated, takes the robot's token from the peer that
//! asked, and gives it back ([`mom_agent`]).
//!
//! Its verb, in `/calibrate`, is `calibrate`, with `camera`: its name, as in `mom calibrate`; and `poses`: in how many to look, 6 to 500,
//! 20 if absent. While it works it tells `pose` and `of`, and at last `rms`, in pixels.

use std::future::Future;

use mom_agent::{Ended, Hired, Trade};
use mom_client::{Client, ClientError, Code, Token, Value, WireError};
use mom_drive::{Commander, DeviceChannel, Doing as _, Holding, VerbFailure};
use tokio::sync::mpsc;

use crate::camera::Camera;
use crate::verb::{self, VerbArgs};

/// In how many poses is looked where nobody says.
const POSES: i64 = 20;
/// Lines of progress that wait to be sent; there is one a pose.
const LINES: usize = 512;

/// The channels and the token of the agent.
#[derive(Debug, Clone, PartialEq)]
pub struct AgentOptions {
    /// Its own channel.
    pub channel: String,
    /// How it calibrates; the camera, and in how many poses, is what others say.
    pub args: VerbArgs,
}

impl Default for AgentOptions {
    /// The lab's.
    fn default() -> AgentOptions {
        AgentOptions {
            channel: "/calibrate".to_owned(),
            args: VerbArgs::of("", 6),
        }
    }
}

/// Which camera is to be calibrated.
#[derive(Debug, Clone)]
struct Order {
    camera: String,
    poses: u16,
}

/// Who calibrates.
struct Calibrator(AgentOptions);

/// Runs the agent until `shutdown` is done; a task under way is cancelled, and the token returned.
///
/// # Errors
///
/// [`ClientError`] if its channel cannot be joined, or the connection is closed for good.
pub async fn run(
    client: Client,
    options: AgentOptions,
    shutdown: impl Future<Output = ()>,
) -> Result<(), ClientError> {
    let channel = options.channel.clone();
    mom_agent::run(client, &channel, Calibrator(options), shutdown).await
}

impl Trade for Calibrator {
    type Task = Order;
    type Tools = (Camera, DeviceChannel);

    const VERB: &'static str = "calibrate";

    fn read(&self, content: &Value) -> Result<Order, WireError> {
        let bad = |text: String| WireError::new(Code::BAD_CONTENT, text);
        let camera = content.get("camera").and_then(Value::as_str);
        let camera = camera.ok_or_else(|| bad("say which `camera`: x, y or top".to_owned()))?;
        let poses = match content.get("poses") {
            None => POSES,
            Some(poses) => poses.as_int().unwrap_or(-1),
        };
        let poses = u16::try_from(poses)
            .ok()
            .filter(|poses| (6..=500).contains(poses));
        Ok(Order {
            camera: camera.to_owned(),
            poses: poses.ok_or_else(|| bad("`poses` are 6 to 500".to_owned()))?,
        })
    }

    fn words(order: &Order) -> String {
        format!("calibrate {}", order.camera)
    }

    async fn meet(&self, hired: &Hired<Order>) -> Result<(Self::Tools, Token), WireError> {
        let met = async {
            let VerbArgs {
                session,
                robot,
                token,
                ..
            } = &self.0.args;
            let path = format!("{}/{}", session.trim_end_matches('/'), hired.task.camera);
            let camera = Camera::meet(DeviceChannel::join(&hired.client, &path).await?).await?;
            let robot = DeviceChannel::join(&hired.client, robot).await?;
            let token = hired.client.token(token).await.doing(format!("join {token}"))?;
            Ok::<_, VerbFailure>(((camera, robot), token))
        };
        met.await
            .map_err(|failure| WireError::new(Code::TRY_LATER, failure.to_string()))
    }

    async fn work(&self, hired: &Hired<Order>, (camera, robot): Self::Tools, holding: Holding) -> Ended {
        let robot = Commander::new(robot, holding.fence());
        match (
            self.calibrate(hired, camera, robot, holding).await,
            hired.cancelled(),
        ) {
            (Ok(rms), _) => {
                let mut ended = Ended::new("done", format!("RMS {rms:.3} px; the camera uses it now"));
                ended.more.set("rms", Value::Double(rms));
                ended
            }
            (Err(failure), Some(why)) => Ended::new("cancelled", format!("{why}: {failure}")),
            (Err(failure), None) => Ended::new("failed", failure.to_string()),
        }
    }
}

impl Calibrator {
    /// Calibrates, and tells each pose; gives the RMS in pixels.
    async fn calibrate(
        &self,
        hired: &Hired<Order>,
        camera: Camera,
        robot: Commander,
        holding: Holding,
    ) -> Result<f64, VerbFailure> {
        let args = VerbArgs {
            view: hired.task.camera.clone(),
            poses: hired.task.poses,
            ..self.0.args.clone()
        };
        let (lines, mut to_tell) = mpsc::channel(LINES);
        let mut rms = None;
        let mut tell = |json: serde_json::Value, line: String| {
            rms = json["rms"].as_f64().or(rms);
            // A line that nobody takes is not worth a pause of the arm.
            let _taken = lines.try_send((json["pose"].as_i64(), json["of"].as_i64(), line));
            Ok(())
        };
        let telling = async {
            while let Some((pose, of, line)) = to_tell.recv().await {
                let (Some(pose), Some(of)) = (pose, of) else {
                    continue;
                };
                let content = hired.report("working").with("text", line);
                hired.tell(content.with("pose", pose).with("of", of)).await;
            }
        };
        let interrupt = async { drop(hired.ends().await) };
        let working = verb::under(&args, camera, robot, holding, interrupt, &mut tell);
        tokio::select! {
            worked = working => worked?,
            () = telling => {}
        }
        rms.ok_or_else(|| VerbFailure::plain("nothing was measured"))
    }
}

#[cfg(test)]
mod tests {
    use mom_client::Map;

    use super::*;

    #[test]
    fn tasks_are_read_and_refused_in_words() {
        let asked = |content: Map| {
            let read = Calibrator(AgentOptions::default()).read(&content.into());
            read.map(|order| (order.camera, order.poses))
        };
        assert_eq!(
            asked(Map::new().with("camera", "x")).ok(),
            Some(("x".to_owned(), 20))
        );
        assert_eq!(
            asked(Map::new().with("camera", "top").with("poses", 6)).ok(),
            Some(("top".to_owned(), 6))
        );
        for (content, word) in [
            (Map::new(), "camera"),
            (Map::new().with("camera", 7), "camera"),
            (Map::new().with("camera", "x").with("poses", 5), "6 to 500"),
            (Map::new().with("camera", "x").with("poses", "many"), "6 to 500"),
        ] {
            let error = asked(content).expect_err("it is not a task");
            assert!(
                error.code == Code::BAD_CONTENT && error.text.contains(word),
                "{error}"
            );
        }
    }
}
