//! Stage `photometric`: the sums of the colour term, surface points with colours against the live image (the report,
//! sections 3.1.2 and 3.1.3; Whelan et al. 2014, *Real-time large-scale dense RGB-D SLAM with volumetric fusion*;
//! Steinbrücker et al. 2011, *Real-Time Visual Odometry from Dense RGB-D Images*). The optimisation is itm-slam's.

use std::sync::OnceLock;

use itm_core::{DepthWeight, Se3};
use itm_shaders::photometric;

use crate::icp::weight_kind;
use crate::map::camera_params;
use crate::raycast::page_features;
use crate::recorder::{Groups, Pipeline};
use crate::sums::{PhotometricSums, Reduce, Shares};
use crate::{BlockMap, Device, Error, RaycastImage, Recorder, SurfelView, View};

/// Surface points with colours, at several levels, each with a quarter of the points of the one before.
#[derive(Debug)]
pub struct PointList {
    finest: usize,
    /// Pixels between the points of the finest level.
    stride: u32,
    /// Size, as an image, and the points.
    levels: Vec<((u32, u32), wgpu::Buffer)>,
}

impl PointList {
    /// Lists for a model's image, at levels from `finest` (2^finest pixels apart along both axes) up to, but without,
    /// `end`; empty until they are recorded.
    pub fn new(device: &Device, model: &RaycastImage, finest: usize, end: usize) -> Self {
        Self::spaced(device, model, finest, end, 1)
    }

    /// The same with only every so many of their points along both axes.
    pub fn spaced(device: &Device, model: &RaycastImage, finest: usize, end: usize, every: u32) -> Self {
        let camera = model.camera();
        let size = |level: usize| {
            let side = |pixels: u32| pixels.div_ceil(every << level).max(1);
            (side(camera.width), side(camera.height))
        };
        let levels = (finest..end.max(finest + 1))
            .map(size)
            .map(|(w, h)| ((w, h), device.storage("coloured points", u64::from(w) * u64::from(h) * 16)))
            .collect();
        Self { finest, stride: every << finest, levels }
    }

    /// The level whose points are nearest to those of a wanted one.
    fn level(&self, level: usize) -> &((u32, u32), wgpu::Buffer) {
        &self.levels[level.saturating_sub(self.finest).min(self.levels.len() - 1)]
    }

    pub(crate) fn buffers(&self) -> impl Iterator<Item = &wgpu::Buffer> {
        self.levels.iter().map(|(_, buffer)| buffer)
    }

    /// Empties the lists.
    pub fn clear(&self, recorder: &mut Recorder) {
        for (_, points) in &self.levels {
            recorder.clear(points, points.size());
        }
    }

    /// Reads a level back: world coordinates in metres and a colour for each point, `None` for none. Waits. For tests.
    ///
    /// # Errors
    /// Where the device was lost.
    #[expect(clippy::type_complexity, reason = "a place and a colour, or none")]
    pub fn read(&self, device: &Device, level: usize) -> Result<Vec<Option<([f32; 3], [u8; 4])>>, Error> {
        let ((width, height), buffer) = self.level(level);
        let words: Vec<[u32; 4]> = device.read(buffer, 0, u64::from(*width) * u64::from(*height) * 16)?;
        let point = |[x, y, z, colour]: [u32; 4]| ([x, y, z].map(f32::from_bits), colour.to_le_bytes());
        Ok(words.into_iter().map(point).map(|p| (p.1[3] > 0).then_some(p)).collect())
    }
}

/// What counts in the colour term, and how much.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PhotometricTerm {
    /// Differences (colours are 0 to 1) as large as this no longer count (Tukey's biweight; Beaton & Tukey 1974, *The
    /// Fitting of Power Series, Meaning Polynomials*).
    pub cutoff: f32,
    /// What a point's colour is multiplied by before it is compared.
    pub gain: f32,
    /// What is added to it then.
    pub offset: f32,
    /// Pixels where the image changes by less than this from one to the next do not count.
    pub least_gradient: f32,
    /// How a point's weight follows its depth.
    pub weight: DepthWeight,
    /// Depth range (metres) that [`DepthWeight::Linear`] refers to.
    pub depth_range_m: [f32; 2],
    /// Level of the colour pyramid, and of the list; 0 is the finest.
    pub level: usize,
    /// Whether the three colours are compared, instead of the intensity 0.299 R + 0.587 G + 0.114 B.
    pub rgb: bool,
}

/// The stage's pipelines.
#[derive(Debug)]
pub struct Photometric {
    device: Device,
    sums: OnceLock<Pipeline>,
    rgb_sums: OnceLock<Pipeline>,
    previous: OnceLock<Pipeline>,
    map: [OnceLock<Pipeline>; 4],
    surfels: OnceLock<Pipeline>,
    halve: OnceLock<Pipeline>,
    shares: Shares,
}

/// Points of one surface lie at most so far apart (metres, a metre away), where they are neighbours in the finest list.
pub const REACH_M: f32 = 0.02;

impl Photometric {
    /// Prepares the stage; pipelines are compiled when first needed.
    pub fn new(device: &Device) -> Self {
        Self {
            device: device.clone(),
            sums: OnceLock::new(),
            rgb_sums: OnceLock::new(),
            previous: OnceLock::new(),
            map: Default::default(),
            surfels: OnceLock::new(),
            halve: OnceLock::new(),
            shares: Shares::new(device),
        }
    }

    /// Records a list of the model's points with the colours that a view shows there, whose colour camera is at
    /// `world_from_colour`. Points with fewer observations than `least_confidence` are left out. Without colour in the view
    /// the list stays as it is.
    pub fn list_previous(
        &self,
        recorder: &mut Recorder,
        list: &PointList,
        model: &RaycastImage,
        view: &View,
        world_from_colour: &Se3,
        least_confidence: f32,
    ) {
        let Some((camera, image)) = view.level_colour(list.finest) else { return };
        recorder.stage("photometric");
        let ((width, height), points) = &list.levels[0];
        let bindings = photometric::previous::Bindings {
            params: photometric::previous::Params {
                colour_camera: camera_params(camera, [0.0, 0.0]),
                colour_camera_from_world: world_from_colour.inverse().to_mat4().to_cols_array_2d(),
                size: [model.camera().width, model.camera().height],
                list_size: [*width, *height],
                stride: list.stride,
                least_confidence,
                unused: [0; 2],
            },
            points: &model.points,
            image,
            list: points,
        };
        let pipeline = self.previous.get_or_init(|| Pipeline::plain(&self.device, &photometric::previous::PASS));
        recorder.dispatch(pipeline, &bindings, Groups::linear(u64::from(width * height), 64));
        self.halve(recorder, list, world_from_colour);
    }

    /// Records a list of the model's points, cast from `world_from_model`, with the map's colours, around which the map's
    /// grid must lie. Without colours in the map the list stays as it is.
    pub fn list_map(
        &self,
        recorder: &mut Recorder,
        list: &PointList,
        model: &RaycastImage,
        map: &BlockMap,
        world_from_model: &Se3,
        least_confidence: f32,
    ) {
        let Some(plane0) = map.colours().first() else { return };
        recorder.stage("photometric");
        let ((width, height), points) = &list.levels[0];
        let pages = map.colours().len();
        let bindings = photometric::map::Bindings {
            params: photometric::map::Params {
                map: map.params(),
                size: [model.camera().width, model.camera().height],
                list_size: [*width, *height],
                stride: list.stride,
                least_confidence,
                unused: [0; 2],
            },
            points: &model.points,
            list: points,
            plane0,
            plane1: map.colours().get(1),
            plane2: map.colours().get(2),
            plane3: map.colours().get(3),
            grid: &map.grid,
        };
        let pipeline = self.map[pages - 1]
            .get_or_init(|| Pipeline::new(&self.device, &photometric::map::PASS, page_features(pages), &[]));
        recorder.dispatch(pipeline, &bindings, Groups::linear(u64::from(width * height), 64));
        self.halve(recorder, list, world_from_model);
    }

    /// The same with the colours of surfels, as [`crate::splat`] has drawn them into `model` and `pixels`.
    pub fn list_surfels(
        &self,
        recorder: &mut Recorder,
        list: &PointList,
        model: &RaycastImage,
        pixels: &SurfelView,
        world_from_model: &Se3,
    ) {
        recorder.stage("photometric");
        let ((width, height), points) = &list.levels[0];
        let bindings = photometric::surfels::Bindings {
            params: photometric::surfels::Params {
                size: [model.camera().width, model.camera().height],
                list_size: [*width, *height],
                stride: list.stride,
                unused_a: 0,
                unused_b: [0; 2],
            },
            points: &model.points,
            colours: &pixels.colours,
            list: points,
        };
        let pipeline = self.surfels.get_or_init(|| Pipeline::plain(&self.device, &photometric::surfels::PASS));
        recorder.dispatch(pipeline, &bindings, Groups::linear(u64::from(width * height), 64));
        self.halve(recorder, list, world_from_model);
    }

    fn halve(&self, recorder: &mut Recorder, list: &PointList, world_from_camera: &Se3) {
        let pipeline = self.halve.get_or_init(|| Pipeline::plain(&self.device, &photometric::halve::PASS));
        for (pair, level) in list.levels.windows(2).zip(0..) {
            let [(size, fine), (half_size, coarse)] = pair else { unreachable!("windows of two") };
            let bindings = photometric::halve::Bindings {
                params: photometric::halve::Params {
                    size: [size.0, size.1],
                    half_size: [half_size.0, half_size.1],
                    reach: REACH_M * (1 << level) as f32,
                    unused_a: 0,
                    unused_b: [0; 2],
                    camera: world_from_camera.translation.as_vec3().extend(1.0).to_array(),
                },
                list: fine,
                halved: coarse,
            };
            recorder.dispatch(pipeline, &bindings, Groups::linear(u64::from(half_size.0 * half_size.1), 64));
        }
    }

    /// Records the sums for a view whose colour camera is taken to be at `world_from_colour`, about a pivot
    /// (world frame). Returns whether there is anything to sum: not without colour.
    #[expect(clippy::too_many_arguments, reason = "a view with its pose, a list, and where the sums go")]
    pub(crate) fn record(
        &self,
        recorder: &mut Recorder,
        view: &View,
        world_from_colour: &Se3,
        list: &PointList,
        pivot: glam::Vec3,
        term: &PhotometricTerm,
        (reduce, slot): (&mut Reduce, usize),
    ) -> bool {
        let Some((camera, image)) = view.level_colour(term.level) else { return false };
        recorder.stage("photometric");
        let ((width, height), points) = list.level(term.level);
        let (groups, rows) = self.shares.of(width * height);
        let bindings = photometric::sums::Bindings {
            params: photometric::sums::Params {
                camera: camera_params(camera, term.depth_range_m),
                camera_from_world: world_from_colour.inverse().to_mat4().to_cols_array_2d(),
                pivot: pivot.to_array(),
                cutoff: term.cutoff,
                gain: term.gain,
                offset: term.offset,
                least_gradient: term.least_gradient,
                depth_weight: weight_kind(term.weight),
                points: width * height,
                rows,
                unused: [0; 2],
            },
            list: points,
            image,
            partial_sums: reduce.partial(slot, rows, PhotometricSums::COLUMNS),
        };
        let (slot_of, features): (_, &[&str]) = if term.rgb { (&self.rgb_sums, &["rgb"]) } else { (&self.sums, &[]) };
        let pipeline = slot_of
            .get_or_init(|| Pipeline::new(&self.device, &photometric::sums::PASS, features, &self.shares.constants()));
        recorder.dispatch(pipeline, &bindings, Groups::Count([groups, 1, 1]));
        reduce.record(recorder, slot, rows, PhotometricSums::COLUMNS);
        true
    }
}
