//! The blocks that lie still, as each camera saw them last.

use mom_vision::Projection;
use mom_vision::blocks::Sighting;
use mom_vision::pose::{View, locate};

use crate::Micros;
use crate::eyes::Seen;
use crate::task::{NAMES, SIZE};
use crate::track::Track;

/// Less of a block is not measured.
const WHOLE: f64 = 0.8;
/// A matrix that moves a block by less is the same, pixels.
const SAME: f64 = 0.2;

/// What each camera saw of each block.
#[derive(Debug, Clone)]
pub struct Memory {
    blocks: Vec<KeptBlock>,
}

#[derive(Debug, Clone, Default)]
struct KeptBlock {
    /// When anything of it was seen.
    noticed: Option<Micros>,
    views: Vec<Option<KeptView>>,
}

#[derive(Debug, Clone)]
struct KeptView {
    sighting: Sighting,
    projection: Projection,
    local: Local,
}

/// Where a block lies on the table, as one camera has it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Local {
    /// mm.
    pub place: [f64; 2],
    /// Deviation of that, mm.
    pub error: f64,
    /// About the vertical, degrees from 0 to 90.
    pub yaw: f64,
    /// Deviation of that, degrees.
    pub yaw_error: f64,
}

impl Default for Memory {
    fn default() -> Memory {
        Memory {
            blocks: vec![KeptBlock::default(); NAMES.len()],
        }
    }
}

impl Memory {
    /// Takes what an image shows. `carried` is not a block on the table; while the hand is `among` the blocks, what is known is kept.
    pub fn see(&mut self, seen: &Seen, projection: &Projection, carried: Option<usize>, among: bool) {
        for (index, sighting) in seen.blocks.iter().enumerate() {
            let (Some(sighting), Some(kept)) = (sighting, self.blocks.get_mut(index)) else {
                continue;
            };
            kept.noticed = kept.noticed.max(Some(seen.taken));
            if carried == Some(index) {
                continue;
            }
            while kept.views.len() <= seen.camera {
                kept.views.push(None);
            }
            let view = &mut kept.views[seen.camera];
            if among && view.is_some() {
                continue;
            }
            if let Some(new) = KeptView::new(sighting.clone(), *projection) {
                *view = Some(new);
            }
        }
    }

    /// Measures again what the cameras' corrected matrices move.
    pub fn correct(&mut self, track: &Track) {
        for block in &mut self.blocks {
            for (camera, view) in block.views.iter_mut().enumerate() {
                if let (Some(kept), Some(projection)) = (view.as_mut(), track.projection(camera)) {
                    kept.correct(projection);
                }
            }
        }
    }

    /// The block is not where it was.
    pub fn forget(&mut self, block: usize) {
        if let Some(kept) = self.blocks.get_mut(block) {
            kept.views.clear();
        }
    }

    /// Where a block lies as a camera has it.
    #[must_use]
    pub fn local(&self, block: usize, camera: usize) -> Option<Local> {
        let view = self.blocks.get(block)?.views.get(camera)?.as_ref()?;
        Some(view.local)
    }

    /// In how many images a block is known.
    #[must_use]
    pub fn views(&self, block: usize) -> usize {
        self.blocks
            .get(block)
            .map_or(0, |kept| kept.views.iter().flatten().count())
    }

    /// Where a block lies by all cameras together.
    #[must_use]
    pub fn place(&self, block: usize) -> Option<Local> {
        let locals: Vec<Local> = self
            .blocks
            .get(block)?
            .views
            .iter()
            .flatten()
            .map(|view| view.local)
            .collect();
        let (mut weight, mut sum, mut turn) = (0.0, [0.0; 2], [0.0; 3]);
        for local in &locals {
            let own = local.error.max(0.1).powi(-2);
            weight += own;
            sum[0] += own * local.place[0];
            sum[1] += own * local.place[1];
            // A quarter turn is the same cube.
            let (sin, cos) = (4.0 * local.yaw.to_radians()).sin_cos();
            let own = local.yaw_error.max(0.1).powi(-2);
            turn = [turn[0] + own * cos, turn[1] + own * sin, turn[2] + own];
        }
        (!locals.is_empty()).then(|| Local {
            place: sum.map(|part| part / weight),
            error: weight.powf(-0.5),
            yaw: (turn[1].atan2(turn[0]).to_degrees() / 4.0).rem_euclid(90.0),
            yaw_error: f64::powf(turn[2], -0.5),
        })
    }

    /// When anything of a block was seen last.
    #[must_use]
    pub fn noticed(&self, block: usize) -> Option<Micros> {
        self.blocks.get(block)?.noticed
    }
}

impl KeptView {
    /// None if it cannot be measured, or not well.
    fn new(sighting: Sighting, projection: Projection) -> Option<KeptView> {
        let local = measure(&sighting, &projection)?;
        Some(KeptView {
            sighting,
            projection,
            local,
        })
    }

    fn correct(&mut self, projection: &Projection) {
        let at = [self.local.place[0], self.local.place[1], SIZE / 2.0];
        let (old, new) = (self.projection.project(at), projection.project(at));
        let far = old.zip(new).map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1]));
        if far.is_some_and(|far| far < SAME) {
            return;
        }
        if let Some(local) = measure(&self.sighting, projection) {
            (self.projection, self.local) = (*projection, local);
        }
    }
}

fn measure(sighting: &Sighting, projection: &Projection) -> Option<Local> {
    if sighting.at_border {
        return None;
    }
    let view = View { projection, sighting };
    let pose = locate(SIZE, &[view], Some(SIZE / 2.0)).ok()?;
    let whole = pose.seen.first().is_some_and(|seen| *seen > WHOLE);
    whole.then_some(Local {
        place: [pose.place[0], pose.place[1]],
        error: pose.error,
        yaw: pose.yaw,
        yaw_error: pose.yaw_error,
    })
}
