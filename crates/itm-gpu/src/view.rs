//! Stage `view`: from a frame's images to what tracking and fusion use (the report, section 3; Newcombe et al. 2011,
//! section 3.2).

use itm_core::{Calibration, ColourImage, DepthConversion, DepthImage, Distortion, Frame, Image, Intrinsics};
use itm_shaders::{types, view};

use crate::map::camera_params;
use crate::recorder::{Groups, Pipeline};
use crate::{Device, Error, Recorder};

/// What a view holds beside depth at full resolution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewOptions {
    /// Depth outside of this range (metres) counts as not measured.
    pub depth_range_m: [f32; 2],
    /// Passes of the bilateral filter.
    pub bilateral_passes: u32,
    /// Levels of the depth pyramid, the finest included; at least 1.
    pub levels: usize,
    /// Whether vertex and normal maps are made, and then between pixels how far to either side normals are taken, at least 1.
    pub vertices: Option<u32>,
    /// Levels of the colour pyramid, the finest included; at least 1.
    pub colour_levels: usize,
    /// Whether each pixel's depth has a weight for fusion, from 1 to [`itm_core::voxel::BEST_OBSERVATION`], by the
    /// sensor's noise; without, every observation counts one.
    pub observation_weights: bool,
}

/// A frame on the device.
#[derive(Debug)]
pub struct View {
    calibration: Calibration,
    raw: wgpu::Buffer,
    scratch: wgpu::Buffer,
    /// The colour image as the lens shows it, where there is a lens.
    distorted_colour: Option<wgpu::Buffer>,
    depth: Vec<(Intrinsics, wgpu::Buffer)>,
    vertices: Option<(wgpu::Buffer, wgpu::Buffer)>,
    /// Depth and its weight.
    observations: Option<wgpu::Buffer>,
    /// Empty until the first frame with colour comes.
    colour: Vec<(Intrinsics, wgpu::Buffer)>,
    has_colour: bool,
}

impl View {
    /// Memory for frames of a calibration.
    pub fn new(device: &Device, calibration: &Calibration, options: &ViewOptions) -> Self {
        let image = |label, camera: &Intrinsics, bytes| device.storage(label, camera.pixels() as u64 * bytes);
        let depth_camera = &calibration.depth;
        let level = |base: &Intrinsics, level: usize| base.at_level(level as u32);
        Self {
            calibration: *calibration,
            raw: image("raw depth", depth_camera, 4),
            scratch: if options.bilateral_passes > 0 || !calibration.depth_distortion.is_none() {
                image("depth scratch", depth_camera, 4)
            } else {
                device.storage("depth scratch", 16)
            },
            depth: (0..options.levels.max(1))
                .map(|l| level(depth_camera, l))
                .map(|camera| (camera, image("depth", &camera, 4)))
                .collect(),
            vertices: options
                .vertices
                .map(|_| (image("vertices", depth_camera, 16), image("view normals", depth_camera, 16))),
            observations: options.observation_weights.then(|| image("observations", depth_camera, 8)),
            distorted_colour: None,
            colour: Vec::new(),
            has_colour: false,
        }
    }

    /// Levels of the depth pyramid.
    pub fn levels(&self) -> usize {
        self.depth.len()
    }

    /// The camera of a level of the depth pyramid; 0 is the finest.
    pub fn level_camera(&self, level: usize) -> &Intrinsics {
        &self.depth[level].0
    }

    /// Depth in metres at full resolution, 0 where there is none.
    pub(crate) fn depth(&self) -> &wgpu::Buffer {
        &self.depth[0].1
    }

    /// Depth in metres and its weight, where the view was made with weights.
    pub(crate) fn observations(&self) -> Option<&wgpu::Buffer> {
        self.observations.as_ref()
    }

    pub(crate) fn level_depth(&self, level: usize) -> &wgpu::Buffer {
        &self.depth[level].1
    }

    /// The colour image (one word a pixel), where the frame has one.
    pub(crate) fn colour(&self) -> Option<&wgpu::Buffer> {
        self.level_colour(0).map(|(_, colour)| colour)
    }

    /// A level of the colour pyramid and its camera, where the frame has colour and the view such a level.
    pub(crate) fn level_colour(&self, level: usize) -> Option<(&Intrinsics, &wgpu::Buffer)> {
        self.colour.get(level).filter(|_| self.has_colour).map(|(camera, colour)| (camera, colour))
    }

    /// Whether the frame has colour.
    pub fn has_colour(&self) -> bool {
        self.has_colour
    }

    /// Vertices and normals (camera frame), where the view was made with them.
    pub(crate) fn vertices(&self) -> Option<(&wgpu::Buffer, &wgpu::Buffer)> {
        self.vertices.as_ref().map(|(vertices, normals)| (vertices, normals))
    }

    /// Reads a level of the depth pyramid back (metres, 0 where there is none). Waits. For tests, exports and pictures.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn read_depth(&self, device: &Device, level: usize) -> Result<Image<f32>, Error> {
        read(device, &self.depth[level].1, &self.depth[level].0)
    }

    /// Reads vertices and normals back (camera frame, metres; the fourth value is 1, or 0 where there is none); `None`
    /// where the view was made without. Waits. For tests, exports and pictures.
    ///
    /// # Errors
    /// Where the device was lost.
    #[expect(clippy::type_complexity, reason = "two images of one kind")]
    pub fn read_vertices(&self, device: &Device) -> Result<Option<(Image<[f32; 4]>, Image<[f32; 4]>)>, Error> {
        let camera = &self.calibration.depth;
        self.vertices.as_ref().map(|(v, n)| Ok((read(device, v, camera)?, read(device, n, camera)?))).transpose()
    }

    /// Reads depth (metres, 0 where there is none) and its weight in fusion back; `None` where the view was made without.
    /// Waits. For tests, exports and pictures.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn read_observations(&self, device: &Device) -> Result<Option<Image<[f32; 2]>>, Error> {
        self.observations.as_ref().map(|o| read(device, o, &self.calibration.depth)).transpose()
    }

    /// Reads a level of the colour pyramid back, undistorted; `None` where the frame has no colour. Waits. For tests, exports
    /// and pictures.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn read_colour(&self, device: &Device, level: usize) -> Result<Option<ColourImage>, Error> {
        self.level_colour(level).map(|(camera, colour)| read(device, colour, camera)).transpose()
    }
}

fn read<T: bytemuck::Pod>(device: &Device, buffer: &wgpu::Buffer, camera: &Intrinsics) -> Result<Image<T>, Error> {
    let values = device.read(buffer, 0, (camera.pixels() * size_of::<T>()) as u64)?;
    Ok(Image::new(camera.width, camera.height, values).expect("as many values as pixels"))
}

/// The stage's pipelines.
#[derive(Debug)]
pub struct ViewStage {
    device: Device,
    convert_depth: Pipeline,
    clip_depth: Pipeline,
    undistort_depth: Pipeline,
    undistort_colour: Pipeline,
    bilateral: Pipeline,
    halve_depth: Pipeline,
    vertices: Pipeline,
    observations: Pipeline,
    halve_colour: Pipeline,
}

/// Neighbouring pixels further apart than this in depth lie on different surfaces.
const DEPTH_EDGE_M: f32 = 0.1;

impl ViewStage {
    /// Compiles the stage.
    pub fn new(device: &Device) -> Self {
        Self {
            device: device.clone(),
            convert_depth: Pipeline::plain(device, &view::convert_depth::PASS),
            clip_depth: Pipeline::plain(device, &view::clip_depth::PASS),
            undistort_depth: Pipeline::plain(device, &view::undistort_depth::PASS),
            undistort_colour: Pipeline::plain(device, &view::undistort_colour::PASS),
            bilateral: Pipeline::plain(device, &view::bilateral::PASS),
            halve_depth: Pipeline::plain(device, &view::halve_depth::PASS),
            vertices: Pipeline::plain(device, &view::vertices::PASS),
            observations: Pipeline::plain(device, &view::observations::PASS),
            halve_colour: Pipeline::plain(device, &view::halve_colour::PASS),
        }
    }

    /// Uploads a frame's images and records what the options ask for. The view must have been made with the same options.
    ///
    /// # Errors
    /// Where an image has another size than the view's calibration says; the view is as it was then.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        view: &mut View,
        frame: &Frame,
        options: &ViewOptions,
    ) -> Result<(), Error> {
        let calibration = view.calibration;
        let depth_size = (calibration.depth.width, calibration.depth.height);
        check_size("depth", frame.depth.size(), depth_size)?;
        if let Some(colour) = &frame.colour {
            check_size("colour", colour.size(), (calibration.colour.width, calibration.colour.height))?;
        }
        recorder.stage("view");
        self.record_depth(recorder, view, &frame.depth, options);
        view.has_colour = frame.colour.is_some();
        if let Some(colour) = &frame.colour {
            self.record_colour(recorder, view, colour, options);
        }
        Ok(())
    }

    fn record_depth(&self, recorder: &mut Recorder, view: &View, depth: &DepthImage, options: &ViewOptions) {
        let camera = view.calibration.depth;
        let size = [camera.width, camera.height];
        let linear = Groups::linear(camera.pixels() as u64, 64);
        let [near_m, far_m] = options.depth_range_m;
        let lens = view.calibration.depth_distortion;
        // With an odd number of passes after it the conversion writes where the first of them reads.
        let (mut from, mut to) = (view.depth(), &view.scratch);
        if (options.bilateral_passes + u32::from(!lens.is_none())) % 2 == 1 {
            std::mem::swap(&mut from, &mut to);
        }
        match depth {
            DepthImage::Raw(image) => {
                // Two values a word: an odd number of pixels leaves half a word.
                let mut values = bytemuck::cast_slice::<u16, u8>(image.data()).to_vec();
                values.resize(values.len().next_multiple_of(4), 0);
                self.device.queue.write_buffer(&view.raw, 0, &values);
                let (kind, a, b) = match view.calibration.depth_conversion {
                    DepthConversion::Affine { scale, offset } => (0, scale, offset),
                    DepthConversion::Disparity { a, b } => (1, a, 8.0 * b * camera.fx),
                };
                let (a, b) = (a as f32, b as f32);
                let params = view::convert_depth::Params { size, kind, a, b, near_m, far_m, unused: 0 };
                let bindings = view::convert_depth::Bindings { params, raw: &view.raw, depth: from };
                recorder.dispatch(&self.convert_depth, &bindings, linear);
            }
            DepthImage::Metres(image) => {
                self.device.queue.write_buffer(&view.raw, 0, bytemuck::cast_slice(image.data()));
                let params = view::clip_depth::Params { size, near_m, far_m };
                let bindings = view::clip_depth::Bindings { params, metres: &view.raw, depth: from };
                recorder.dispatch(&self.clip_depth, &bindings, linear);
            }
        }
        if !lens.is_none() {
            let params = view::undistort_depth::Params {
                camera: camera_params(&camera, options.depth_range_m),
                lens: lens_params(&lens),
            };
            let bindings = view::undistort_depth::Bindings { params, distorted: from, depth: to };
            recorder.dispatch(&self.undistort_depth, &bindings, Groups::image((camera.width, camera.height), (64, 1)));
            std::mem::swap(&mut from, &mut to);
        }
        for _ in 0..options.bilateral_passes {
            let params = view::bilateral::Params { size };
            let bindings = view::bilateral::Bindings { params, depth: from, filtered: to };
            recorder.dispatch(&self.bilateral, &bindings, Groups::image((camera.width, camera.height), (64, 1)));
            std::mem::swap(&mut from, &mut to);
        }
        for pair in view.depth.windows(2) {
            let [(fine, depth), (coarse, halved)] = pair else { unreachable!("windows of two") };
            let bindings = view::halve_depth::Bindings {
                params: view::halve_depth::Params {
                    size: [fine.width, fine.height],
                    half_size: [coarse.width, coarse.height],
                    reach_m: DEPTH_EDGE_M,
                    unused_a: 0,
                    unused_b: [0; 2],
                },
                depth,
                halved,
            };
            recorder.dispatch(&self.halve_depth, &bindings, Groups::image((coarse.width, coarse.height), (64, 1)));
        }
        if let (Some((vertices, normals)), Some(apart)) = (&view.vertices, options.vertices) {
            let params = view::vertices::Params {
                camera: camera_params(&camera, options.depth_range_m),
                reach_m: DEPTH_EDGE_M,
                apart: i32::try_from(apart).unwrap_or(i32::MAX),
                unused_b: [0; 2],
            };
            let bindings = view::vertices::Bindings { params, depth: view.depth(), vertices, normals };
            recorder.dispatch(&self.vertices, &bindings, Groups::image((camera.width, camera.height), (64, 1)));
        }
        if let Some(observations) = &view.observations {
            let params = view::observations::Params {
                camera: camera_params(&camera, options.depth_range_m),
                reach_m: DEPTH_EDGE_M,
                unused_a: 0,
                unused_b: [0; 2],
            };
            let bindings = view::observations::Bindings { params, depth: view.depth(), observations };
            recorder.dispatch(&self.observations, &bindings, Groups::image((camera.width, camera.height), (64, 1)));
        }
    }

    fn record_colour(&self, recorder: &mut Recorder, view: &mut View, image: &ColourImage, options: &ViewOptions) {
        let camera = view.calibration.colour;
        let lens = view.calibration.colour_distortion;
        let memory = |label, camera: &Intrinsics| self.device.storage(label, camera.pixels() as u64 * 4);
        if view.colour.is_empty() {
            let levels = (0..options.colour_levels.max(1)).map(|level| camera.at_level(level as u32));
            view.colour = levels.map(|camera| (camera, memory("colour", &camera))).collect();
        }
        let colour = &view.colour[0].1;
        let values = bytemuck::cast_slice(image.data());
        if lens.is_none() {
            self.device.queue.write_buffer(colour, 0, values);
        } else {
            let distorted = &*view.distorted_colour.get_or_insert_with(|| memory("distorted colour", &camera));
            self.device.queue.write_buffer(distorted, 0, values);
            let params =
                view::undistort_colour::Params { camera: camera_params(&camera, [0.0; 2]), lens: lens_params(&lens) };
            let bindings = view::undistort_colour::Bindings { params, distorted, colour };
            recorder.dispatch(&self.undistort_colour, &bindings, Groups::image((camera.width, camera.height), (64, 1)));
        }
        for pair in view.colour.windows(2) {
            let [(fine, colour), (coarse, halved)] = pair else { unreachable!("windows of two") };
            let params = view::halve_colour::Params {
                size: [fine.width, fine.height],
                half_size: [coarse.width, coarse.height],
            };
            let bindings = view::halve_colour::Bindings { params, colour, halved };
            recorder.dispatch(&self.halve_colour, &bindings, Groups::image((coarse.width, coarse.height), (64, 1)));
        }
    }
}

fn lens_params(lens: &Distortion) -> types::Distortion {
    let [k1, k2, p1, p2, k3, k4, k5, k6] = lens.coefficients().map(|c| c as f32);
    types::Distortion { k1, k2, p1, p2, k3, k4, k5, k6 }
}

fn check_size(image: &'static str, found: (u32, u32), expected: (u32, u32)) -> Result<(), Error> {
    if found == expected { Ok(()) } else { Err(Error::ImageSize { image, found, expected }) }
}
