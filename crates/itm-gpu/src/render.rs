//! Stage `render`: pictures of a raycast image.

use std::sync::OnceLock;

use glam::DVec3;
use itm_core::{ColourImage, Intrinsics, Se3};
use itm_shaders::render;

use crate::raycast::page_features;
use crate::recorder::{Groups, Pipeline};
use crate::{BlockMap, Device, Error, RaycastImage, Recorder, SurfelView};

/// What a picture of the map shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shading {
    /// Grey, lit from the camera (Lambert).
    Grey,
    /// The same with a highlight where light is mirrored to the camera, so that bends of the surface stand out (Phong 1975,
    /// *Illumination for Computer Generated Pictures*).
    Phong,
    /// Normals as colours: red, green, blue for the world's x, y, z.
    Normals,
    /// The map's own colours; nothing where it has none.
    Colour,
    /// Depth along the optical axis, on a scale from dark blue (near) to yellow (far).
    Depth,
    /// How well points are known, on the same scale from poorly to well: the map's confidence where it keeps one, otherwise the
    /// number of observations.
    Confidence,
}

/// The values at the ends of the scale of colours.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    /// Nearest and farthest depth in metres.
    pub depth_m: [f32; 2],
    /// Confidence, or number of observations, at the scale's upper end; its lower end is 0.
    pub confidence: f32,
}

impl Default for Scale {
    fn default() -> Self {
        Self { depth_m: [0.0, 4.0], confidence: 100.0 }
    }
}

impl Shading {
    /// As `render/shade.wgsl` numbers it, with the scale's ends.
    fn kind_and_range(self, scale: &Scale) -> (u32, [f32; 2]) {
        match self {
            // Colours do not come from that pass.
            Self::Grey | Self::Colour => (0, [0.0, 1.0]),
            Self::Normals => (1, [0.0, 1.0]),
            Self::Depth => (2, scale.depth_m),
            Self::Confidence => (3, [0.0, scale.confidence]),
            Self::Phong => (4, [0.0, 1.0]),
        }
    }
}

/// The stage's pipelines.
#[derive(Debug)]
pub struct Render {
    device: Device,
    shade: Pipeline,
    colour: [OnceLock<Pipeline>; 4],
}

impl Render {
    /// Compiles the stage.
    pub fn new(device: &Device) -> Self {
        Self {
            device: device.clone(),
            shade: Pipeline::plain(device, &render::shade::PASS),
            colour: Default::default(),
        }
    }

    /// The same for an image of surfels; see [`crate::splat`].
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn run_surfels(
        &self,
        pixels: &SurfelView,
        image: &RaycastImage,
        world_from_camera: &Se3,
        shading: Shading,
        scale: &Scale,
    ) -> Result<ColourImage, Error> {
        if shading != Shading::Colour {
            return self.shade(image, world_from_camera, shading, scale);
        }
        pixels.read_colours(&self.device)
    }

    /// Paints an image that was cast from a pose, with normals, and confidences where those are to be seen; pixels that show
    /// nothing have alpha 0. Waits.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn run(
        &self,
        map: &BlockMap,
        image: &RaycastImage,
        world_from_camera: &Se3,
        shading: Shading,
        scale: &Scale,
    ) -> Result<ColourImage, Error> {
        if shading != Shading::Colour {
            return self.shade(image, world_from_camera, shading, scale);
        }
        let camera = image.camera();
        let pixels = camera.pixels() as u64;
        let size = [camera.width, camera.height];
        let painted = self.device.storage("picture", pixels * 4);
        let mut recorder = Recorder::new(&self.device);
        recorder.stage("render");
        if let Some(plane0) = map.colours().first() {
            let pages = map.colours().len();
            let pipeline = self.colour[pages - 1]
                .get_or_init(|| Pipeline::new(&self.device, &render::colour::PASS, page_features(pages), &[]));
            let bindings = render::colour::Bindings {
                params: render::colour::Params { map: map.params(), size, unused: [0; 2] },
                points: &image.points,
                image: &painted,
                plane0,
                plane1: map.colours().get(1),
                plane2: map.colours().get(2),
                plane3: map.colours().get(3),
                grid: &map.grid,
            };
            recorder.dispatch(pipeline, &bindings, Groups::linear(pixels, 64));
        }
        self.read_picture(recorder, camera, &painted)
    }

    /// Paints an image by its points and normals.
    fn shade(
        &self,
        image: &RaycastImage,
        world_from_camera: &Se3,
        shading: Shading,
        scale: &Scale,
    ) -> Result<ColourImage, Error> {
        let camera = image.camera();
        let pixels = camera.pixels() as u64;
        let painted = self.device.storage("picture", pixels * 4);
        let mut recorder = Recorder::new(&self.device);
        recorder.stage("render");
        let (kind, range) = shading.kind_and_range(scale);
        let bindings = render::shade::Bindings {
            params: render::shade::Params {
                size: [camera.width, camera.height],
                kind,
                unused_a: 0,
                camera: world_from_camera.translation.as_vec3().extend(1.0).to_array(),
                forward: (world_from_camera.rotation * DVec3::Z).as_vec3().extend(0.0).to_array(),
                range,
                unused_b: [0; 2],
            },
            points: &image.points,
            normals: &image.normals,
            image: &painted,
        };
        recorder.dispatch(&self.shade, &bindings, Groups::linear(pixels, 64));
        self.read_picture(recorder, camera, &painted)
    }

    fn read_picture(
        &self,
        recorder: Recorder,
        camera: &Intrinsics,
        painted: &wgpu::Buffer,
    ) -> Result<ColourImage, Error> {
        let _untimed = recorder.submit();
        let values = self.device.read(painted, 0, camera.pixels() as u64 * 4)?;
        Ok(ColourImage::new(camera.width, camera.height, values).expect("as many values as pixels"))
    }
}
