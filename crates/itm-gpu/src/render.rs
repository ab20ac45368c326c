//! Stage `render`: pictures of a raycast image.

use std::sync::OnceLock;

use glam::DVec3;
use itm_core::{ColourImage, Se3};
use itm_shaders::render;

use crate::raycast::page_features;
use crate::recorder::{Groups, Pipeline};
use crate::{BlockMap, Canvas, Device, Error, RaycastImage, Recorder, SurfelView};

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
    /// As `shared/shading.wgsl` numbers it, with the scale's ends.
    pub(crate) fn kind_and_range(self, scale: &Scale) -> (u32, [f32; 2]) {
        match self {
            Self::Grey => (0, [0.0, 1.0]),
            Self::Normals => (1, [0.0, 1.0]),
            Self::Depth => (2, scale.depth_m),
            Self::Confidence => (3, [0.0, scale.confidence]),
            Self::Phong => (4, [0.0, 1.0]),
            Self::Colour => (5, [0.0, 1.0]),
        }
    }
}

/// A raycast image and what it shows.
#[derive(Clone, Copy, Debug)]
pub struct Seen<'a> {
    /// The image, with normals, and confidences where those are to be seen.
    pub image: &'a RaycastImage,
    /// The pose that it was cast from.
    pub map_from_camera: &'a Se3,
    /// Where the map's frame lies in the world's, for normals; of a whole map the identity.
    pub world_from_map: &'a Se3,
    /// What it is of.
    pub of: Of<'a>,
}

/// What kind of map an image is of.
#[derive(Clone, Copy, Debug)]
pub enum Of<'a> {
    /// Voxels: the map, with the grid of the view.
    Voxels(&'a BlockMap),
    /// Surfels: the pixels that they were drawn into; see [`crate::splat`].
    Surfels(&'a SurfelView),
}

/// The stage's pipelines.
#[derive(Debug)]
pub struct Render {
    device: Device,
    shade: Pipeline,
    colour: [OnceLock<Pipeline>; 4],
    compose: OnceLock<Pipeline>,
}

impl Render {
    /// Compiles the stage.
    pub fn new(device: &Device) -> Self {
        Self {
            device: device.clone(),
            shade: Pipeline::plain(device, &render::shade::PASS),
            colour: Default::default(),
            compose: OnceLock::new(),
        }
    }

    /// Paints an image; pixels that show nothing have alpha 0. Waits.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn run(&self, seen: &Seen<'_>, shading: Shading, scale: &Scale) -> Result<ColourImage, Error> {
        let camera = seen.image.camera();
        let mut recorder = Recorder::new(&self.device);
        let painted = self.record(&mut recorder, seen, shading, scale);
        let _untimed = recorder.submit();
        let values = self.device.read(&painted, 0, camera.pixels() as u64 * 4)?;
        Ok(ColourImage::new(camera.width, camera.height, values).expect("as many values as pixels"))
    }

    /// Records that an image is painted onto a canvas of its size, where it is nearer than what was painted there since the
    /// canvas was cleared.
    ///
    /// # Panics
    /// If the canvas has another size.
    pub fn paint(&self, recorder: &mut Recorder, seen: &Seen<'_>, shading: Shading, scale: &Scale, canvas: &Canvas) {
        let camera = seen.image.camera();
        let size = [camera.width, camera.height];
        assert_eq!(size, <[u32; 2]>::from(canvas.size()), "a canvas for another camera");
        let picture = self.record(recorder, seen, shading, scale);
        let pipeline = self.compose.get_or_init(|| Pipeline::plain(&self.device, &render::compose::PASS));
        let [centre, forward] = centre_and_axis(seen.map_from_camera);
        let bindings = render::compose::Bindings {
            params: render::compose::Params { size, pitch: canvas.pitch(), unused: 0, camera: centre, forward },
            points: &seen.image.points,
            picture: &picture,
            depths: &canvas.depths,
            canvas: &canvas.painted,
        };
        recorder.dispatch(pipeline, &bindings, Groups::linear(camera.pixels() as u64, 64));
    }

    /// Records the painting of an image, and returns where it lies: row by row, without gaps.
    fn record(&self, recorder: &mut Recorder, seen: &Seen<'_>, shading: Shading, scale: &Scale) -> wgpu::Buffer {
        recorder.stage("render");
        match (shading, seen.of) {
            (Shading::Colour, Of::Voxels(map)) => self.colours(recorder, seen.image, map),
            (Shading::Colour, Of::Surfels(pixels)) => pixels.colours.clone(),
            _ => self.shade(recorder, seen, shading, scale),
        }
    }

    fn colours(&self, recorder: &mut Recorder, image: &RaycastImage, map: &BlockMap) -> wgpu::Buffer {
        let camera = image.camera();
        let painted = self.device.storage("picture", camera.pixels() as u64 * 4);
        if let Some(plane0) = map.colours().first() {
            let pages = map.colours().len();
            let pipeline = self.colour[pages - 1]
                .get_or_init(|| Pipeline::new(&self.device, &render::colour::PASS, page_features(pages), &[]));
            let bindings = render::colour::Bindings {
                params: render::colour::Params {
                    map: map.params(),
                    size: [camera.width, camera.height],
                    unused: [0; 2],
                },
                points: &image.points,
                image: &painted,
                plane0,
                plane1: map.colours().get(1),
                plane2: map.colours().get(2),
                plane3: map.colours().get(3),
                grid: &map.grid,
            };
            recorder.dispatch(pipeline, &bindings, Groups::linear(camera.pixels() as u64, 64));
        }
        painted
    }

    /// By its points and normals.
    fn shade(&self, recorder: &mut Recorder, seen: &Seen<'_>, shading: Shading, scale: &Scale) -> wgpu::Buffer {
        let camera = seen.image.camera();
        let pixels = camera.pixels() as u64;
        let painted = self.device.storage("picture", pixels * 4);
        let (kind, range) = shading.kind_and_range(scale);
        let [centre, forward] = centre_and_axis(seen.map_from_camera);
        let turn = seen.world_from_map.rotation;
        // The rows are what the inverse turns the axes to.
        let row = |axis: DVec3| (turn.inverse() * axis).as_vec3().extend(0.0).to_array();
        let bindings = render::shade::Bindings {
            params: render::shade::Params {
                size: [camera.width, camera.height],
                kind,
                unused_a: 0,
                camera: centre,
                forward,
                range,
                unused_b: [0; 2],
                turn_x: row(DVec3::X),
                turn_y: row(DVec3::Y),
                turn_z: row(DVec3::Z),
            },
            points: &seen.image.points,
            normals: &seen.image.normals,
            image: &painted,
        };
        recorder.dispatch(&self.shade, &bindings, Groups::linear(pixels, 64));
        painted
    }
}

/// A camera's centre, and the unit vector along its optical axis.
fn centre_and_axis(map_from_camera: &Se3) -> [[f32; 4]; 2] {
    let forward = map_from_camera.rotation * DVec3::Z;
    [map_from_camera.translation.as_vec3().extend(1.0).to_array(), forward.as_vec3().extend(0.0).to_array()]
}
