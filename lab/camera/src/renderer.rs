//! One camera: a view with its settings, from a scene to an encoded image.

use tiny_skia::Pixmap;

use crate::draw::{self, Canvas};
use crate::encode::encode;
use crate::geometry::Point;
use crate::robot::{self, ToolFrame};
use crate::scene::{DrawnBlock, MOST_BLOCKS, MOST_POSES, Scene, half_edges};
use crate::solid::Solid;
use crate::view;
use crate::{Camera, CameraSettings, Format, Overlay, SettingsError, View};

/// Renders scenes as one of the cameras sees them.
///
/// The same scene gives the same bytes.
///
/// ```
/// use mom_camera::{Renderer, Scene, CameraSettings, View};
///
/// let renderer = Renderer::new(View::Top, CameraSettings::default())?;
/// let image = renderer.render(&Scene::default());
/// assert_eq!(image.media_type, "image/jpeg");
/// assert_eq!((image.width, image.height), (640, 480));
/// # Ok::<(), mom_camera::SettingsError>(())
/// ```
#[derive(Debug, Clone)]
pub struct Renderer {
    view: View,
    settings: CameraSettings,
    /// The static background, drawn once; `None` for a camera that moves.
    backdrop: Option<Pixmap>,
}

/// An encoded image and the camera that took it.
#[derive(Debug, Clone, PartialEq)]
pub struct Image {
    /// The file.
    pub bytes: Vec<u8>,
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// The image format.
    pub format: Format,
    /// The format's media type.
    pub media_type: &'static str,
    /// The 3×4 projection matrix of this image, row by row, mm to pixels (M55); see [`Camera::matrix`].
    pub matrix: [f64; 12],
}

impl Renderer {
    /// A renderer for a view, or the setting that is outside its limits.
    pub fn new(view: View, settings: CameraSettings) -> Result<Renderer, SettingsError> {
        settings.check()?;
        let mut renderer = Renderer {
            view,
            settings,
            backdrop: None,
        };
        if view.is_fixed() {
            let camera = renderer.camera(&Scene::default());
            renderer.backdrop = Some(renderer.draw_backdrop(&camera));
        }
        Ok(renderer)
    }

    /// Which camera this is.
    pub fn view(&self) -> View {
        self.view
    }

    /// The settings of its images.
    pub fn settings(&self) -> CameraSettings {
        self.settings
    }

    /// Draws and encodes a scene.
    ///
    /// Any scene can be drawn: numbers that are not finite count as 0, and at most 64 blocks and the newest 200 poses
    /// of the trail are drawn.
    pub fn render(&self, scene: &Scene) -> Image {
        let scene = scene.drawable(MOST_BLOCKS, MOST_POSES);
        let camera = self.camera(&scene);
        let mut pixels = match &self.backdrop {
            Some(backdrop) => backdrop.clone(),
            None => self.draw_backdrop(&camera),
        };
        self.draw(
            &mut Canvas {
                pixels: &mut pixels,
                camera: &camera,
            },
            &scene,
        );
        Image {
            bytes: encode(&pixels, &self.settings),
            width: self.settings.width,
            height: self.settings.height,
            format: self.settings.format,
            media_type: self.settings.format.media_type(),
            matrix: camera.matrix(),
        }
    }

    fn camera(&self, scene: &Scene) -> Camera {
        let (width, height) = (self.settings.width, self.settings.height);
        match self.view {
            View::Pan => scene.aim.camera(view::across(width, height), (width, height)),
            view => view.camera(&scene.pose, width, height),
        }
    }

    fn draw_backdrop(&self, camera: &Camera) -> Pixmap {
        let mut pixels = Pixmap::new(self.settings.width, self.settings.height)
            .expect("the settings' limits exclude sizes that have no pixels");
        draw::backdrop(
            &mut Canvas {
                pixels: &mut pixels,
                camera,
            },
            self.view,
        );
        pixels
    }

    fn draw(&self, canvas: &mut Canvas<'_>, scene: &Scene) {
        let tool = ToolFrame::new(&scene.pose);
        let gripper = robot::gripper(&tool, &scene.gripper);
        let arm = robot::arm(&tool);
        draw::shadows(canvas, &scene.blocks, &gripper, &arm, &scene.pose);
        let mut solids: Vec<Solid> = scene.blocks.iter().map(block).collect();
        solids.extend(gripper);
        // The camera on the forearm would see these from within.
        if self.view != View::Wrist {
            solids.extend(arm);
            solids.extend(robot::wrist_camera(&tool));
        }
        draw::solids(canvas, &solids);
        if self.settings.overlay {
            draw::overlays(canvas, &Overlay::of(scene));
            draw::trail(canvas, &scene.trail);
            draw::caption(canvas, self.view, scene);
        }
    }
}

fn block(block: &DrawnBlock) -> Solid {
    Solid::cuboid(
        Point::new(block.x, block.y, block.z),
        half_edges(block),
        block.colour,
    )
}
