//! What the tests share: the device, scenes whose depth is known in closed form, and a map on the device with the stages
//! that fill it.

#![allow(dead_code, reason = "each test binary uses its own part")]

use std::sync::OnceLock;

use glam::{DVec2, DVec3};
use itm_core::voxel::{BlockKey, VoxelKind};
use itm_core::{Calibration, ColourImage, DepthConversion, DepthImage, Frame, Image, Intrinsics, Se3, Timestamp};
use itm_gpu::allocate::Allocate;
use itm_gpu::hash::Hash;
use itm_gpu::integrate::{Integrate, IntegrateOptions};
use itm_gpu::normals::Normals;
use itm_gpu::ranges::Ranges;
use itm_gpu::raycast::Raycast;
use itm_gpu::view::{ViewOptions, ViewStage};
use itm_gpu::visible::Visible;
use itm_gpu::{BlockMap, Device, FrameRecord, MapLayout, RaycastImage, Recorder, View, reference};
use proptest::prop_assert;
use proptest::test_runner::{Config as ProptestConfig, TestCaseError};

/// The device, opened once for a test binary; `None` where the environment variable `ITM_SKIP_GPU_TESTS` is set.
///
/// # Panics
/// Where no adapter can be opened: a test that cannot run has failed.
#[expect(clippy::print_stdout, reason = "a test that checks nothing says so")]
pub(crate) fn device() -> Option<&'static Device> {
    if std::env::var_os("ITM_SKIP_GPU_TESTS").is_some() {
        println!("skipped, because ITM_SKIP_GPU_TESTS is set");
        return None;
    }
    static DEVICE: OnceLock<Device> = OnceLock::new();
    Some(DEVICE.get_or_init(|| Device::open("auto").expect("GPU tests need an adapter; a software driver will do")))
}

/// Few cases, because the device may be a software one. A failure's input is printed in full, and kept nowhere else.
pub(crate) fn cases(cases: u32) -> ProptestConfig {
    ProptestConfig { cases, failure_persistence: None, ..ProptestConfig::default() }
}

/// The same adapter opened anew with WebGPU's default limits, and such that a buffer holds at most so many bytes for a
/// shader: maps then come in several pages early.
///
/// # Panics
/// Where it cannot be opened.
pub(crate) fn device_with_bindings_of(bytes: u64) -> Device {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    descriptor.backends = wgpu::Backends::VULKAN | wgpu::Backends::METAL | wgpu::Backends::DX12;
    let instance = wgpu::Instance::new(descriptor);
    let adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::all()));
    let name = device().expect("asked only where a device is").name();
    let adapter = adapters.iter().find(|a| a.get_info().name == name).expect("it was opened before");
    let limits = wgpu::Limits { max_storage_buffer_binding_size: bytes, ..Default::default() };
    let descriptor = wgpu::DeviceDescriptor { required_limits: limits, ..Default::default() };
    let (device, queue) = pollster::block_on(adapter.request_device(&descriptor)).expect("lower limits than it has");
    Device::from_wgpu(device, queue, &adapter.get_info()).expect("all that the stages need")
}

/// The device and the stages of fusion, compiled once.
#[derive(Debug)]
pub(crate) struct Gpu {
    pub(crate) device: Device,
    pub(crate) view: ViewStage,
    pub(crate) allocate: Allocate,
    pub(crate) visible: Visible,
    pub(crate) integrate: Integrate,
    pub(crate) ranges: Ranges,
    pub(crate) raycast: Raycast,
    pub(crate) normals: Normals,
    pub(crate) hash: Hash,
}

impl Gpu {
    pub(crate) fn new(device: &Device) -> Self {
        Self {
            device: device.clone(),
            view: ViewStage::new(device),
            allocate: Allocate::new(device),
            visible: Visible::new(device),
            integrate: Integrate::new(device),
            ranges: Ranges::new(device),
            raycast: Raycast::new(device),
            normals: Normals::new(device),
            hash: Hash::new(device),
        }
    }
}

impl Gpu {
    /// A view of a frame.
    pub(crate) fn see(&self, calibration: &Calibration, frame: &Frame) -> View {
        let mut view = View::new(&self.device, calibration, &VIEW_OPTIONS);
        let mut recorder = Recorder::new(&self.device);
        self.view.record(&mut recorder, &mut view, frame, &VIEW_OPTIONS).expect("the sizes are right");
        let _untimed = recorder.submit();
        view
    }
}

/// [`device`] with the stages.
pub(crate) fn gpu() -> Option<&'static Gpu> {
    static GPU: OnceLock<Gpu> = OnceLock::new();
    device().map(|device| GPU.get_or_init(|| Gpu::new(device)))
}

/// A camera with a field of view of about 60 degrees along its longer side, its principal point beside the middle.
pub(crate) fn camera(width: u32, height: u32) -> Intrinsics {
    let focal = 0.87 * f64::from(width.max(height));
    Intrinsics::new(width, height, focal, focal * 1.01, f64::from(width) * 0.49, f64::from(height) * 0.52)
}

/// One camera for depth, and for colour if any.
pub(crate) fn one_camera(camera: Intrinsics) -> Calibration {
    Calibration::registered(camera, DepthConversion::MILLIMETRES)
}

/// A frame of depth in metres, with colour if any.
pub(crate) fn frame(depth: Image<f32>, colour: Option<ColourImage>) -> Frame {
    Frame::new(0, Timestamp(0), DepthImage::Metres(depth), colour)
}

/// Something whose surface a ray meets in closed form (world frame, metres).
#[derive(Clone, Copy, Debug)]
pub(crate) enum Shape {
    /// The points with `normal · p = distance`; the normal has unit length.
    Plane { normal: DVec3, distance: f64 },
    /// A sphere, seen from outside.
    Sphere { centre: DVec3, radius: f64 },
    /// A box along the axes, seen from outside.
    Cuboid { centre: DVec3, half: DVec3 },
    /// The inside of a box along the axes.
    Room { centre: DVec3, half: DVec3 },
}

impl Shape {
    /// Where a ray meets the surface first, as a multiple of `ray`.
    fn meet(&self, origin: DVec3, ray: DVec3) -> Option<f64> {
        let found = match *self {
            Self::Plane { normal, distance } => (distance - normal.dot(origin)) / normal.dot(ray),
            Self::Sphere { centre, radius } => {
                let to = centre - origin;
                let (a, b) = (ray.length_squared(), ray.dot(to));
                let root = b * b - a * (to.length_squared() - radius * radius);
                if root < 0.0 {
                    return None;
                }
                (b - root.sqrt()) / a
            }
            Self::Cuboid { centre, half } | Self::Room { centre, half } => {
                let (a, b) = ((centre - half - origin) / ray, (centre + half - origin) / ray);
                let (enter, leave) = (a.min(b).max_element(), a.max(b).min_element());
                if enter > leave {
                    return None;
                }
                if matches!(self, Self::Room { .. }) { leave } else { enter }
            }
        };
        (found.is_finite() && found > 0.0).then_some(found)
    }

    /// Distance of a point from the surface, in metres.
    pub(crate) fn distance(&self, point: DVec3) -> f64 {
        match *self {
            Self::Plane { normal, distance } => (normal.dot(point) - distance).abs(),
            Self::Sphere { centre, radius } => (point.distance(centre) - radius).abs(),
            Self::Cuboid { centre, half } | Self::Room { centre, half } => {
                let outside = (point - centre).abs() - half;
                (outside.max(DVec3::ZERO).length() + outside.max_element().min(0.0)).abs()
            }
        }
    }

    /// The surface's normal near a point of it, towards whoever sees it.
    fn normal(&self, point: DVec3, seen_from: DVec3) -> DVec3 {
        let normal = match *self {
            Self::Plane { normal, .. } => normal,
            Self::Sphere { centre, .. } => (point - centre).normalize(),
            Self::Cuboid { centre, half } | Self::Room { centre, half } => {
                let outside = ((point - centre).abs() - half).to_array();
                let nearest = outside.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1)).expect("three axes").0;
                DVec3::AXES[nearest]
            }
        };
        if normal.dot(seen_from - point) < 0.0 { -normal } else { normal }
    }
}

/// Several shapes.
#[derive(Clone, Debug)]
pub(crate) struct Scene(pub(crate) Vec<Shape>);

impl Scene {
    /// A room of 3.2 x 2.4 x 3.6 m around the origin with a ball and a box in it.
    pub(crate) fn room() -> Self {
        Self(vec![
            Shape::Room { centre: DVec3::new(0.03, -0.02, 0.01), half: DVec3::new(1.6, 1.2, 1.8) },
            Shape::Sphere { centre: DVec3::new(0.3, 0.2, 0.9), radius: 0.4 },
            Shape::Cuboid { centre: DVec3::new(-0.7, 0.8, 1.0), half: DVec3::new(0.3, 0.35, 0.25) },
        ])
    }

    /// What a depth camera without noise measures: metres along the optical axis, 0 where a ray meets nothing.
    pub(crate) fn depth(&self, camera: &Intrinsics, world_from_camera: &Se3) -> Image<f32> {
        Image::from_fn(camera.width, camera.height, |x, y| {
            let ray = camera.unproject(DVec2::new(x.into(), y.into()), 1.0);
            let ray = world_from_camera.transform_vector(ray);
            let meet = |shape: &Shape| shape.meet(world_from_camera.translation, ray);
            self.0.iter().filter_map(meet).reduce(f64::min).unwrap_or(0.0) as f32
        })
    }

    /// What a colour camera sees of surfaces painted smoothly, as a function of the place in the world; no colour where a ray
    /// meets nothing.
    pub(crate) fn colour(&self, camera: &Intrinsics, world_from_camera: &Se3) -> ColourImage {
        let depth = self.depth(camera, world_from_camera);
        ColourImage::from_fn(camera.width, camera.height, |x, y| {
            let z = f64::from(depth[(x, y)]);
            if z == 0.0 {
                return [0; 4];
            }
            let seen = camera.unproject(DVec2::new(x.into(), y.into()), z);
            let [r, g, b] =
                paint(world_from_camera.transform_point(seen)).to_array().map(|v| (255.0 * v).round() as u8);
            [r, g, b, 255]
        })
    }

    /// The shape nearest to a point.
    fn nearest(&self, point: DVec3) -> &Shape {
        self.0.iter().min_by(|a, b| a.distance(point).total_cmp(&b.distance(point))).expect("a scene has shapes")
    }

    /// Distance of a point from the nearest surface, in metres.
    pub(crate) fn distance(&self, point: DVec3) -> f64 {
        self.nearest(point).distance(point)
    }

    /// The normal of the surface nearest to a point, towards whoever sees it.
    pub(crate) fn normal(&self, point: DVec3, seen_from: DVec3) -> DVec3 {
        self.nearest(point).normal(point, seen_from)
    }
}

/// Colour, 0 to 1, of a surface at a place in the world: waves of about 0.4 m.
pub(crate) fn paint(place: DVec3) -> DVec3 {
    let wave = |x: f64, y: f64, z: f64| 0.5 + 0.4 * (place.dot(DVec3::new(x, y, z))).sin();
    DVec3::new(wave(15.0, 5.0, -8.0), wave(-5.0, 16.0, 5.0), wave(7.0, -7.0, 12.0))
}

/// A colour image without flat or straight parts.
pub(crate) fn colours(camera: &Intrinsics) -> ColourImage {
    ColourImage::from_fn(camera.width, camera.height, |x, y| {
        let wave = |a: f64, b: f64| (127.5 + 127.4 * (a * f64::from(x) + b * f64::from(y)).sin()) as u8;
        [wave(0.31, 0.12), wave(-0.07, 0.4), wave(0.02, -0.05), 255]
    })
}

/// Poses in the room, not far apart, each looking towards the ball.
pub(crate) fn poses() -> [Se3; 3] {
    [[-0.1, -0.1, -1.0, 0.05, -0.1, 0.02], [0.2, 0.05, -0.9, -0.08, 0.06, -0.1], [0.0, -0.2, -1.1, -0.15, 0.02, 0.3]]
        .map(Se3::exp)
}

/// How the tests fuse.
pub(crate) const OPTIONS: IntegrateOptions =
    IntegrateOptions { max_weight: 100, stop_at_max_weight: false, colour_band: 0.5, empty_loss: 0, weighted: false };

/// Depth that the tests look at, in metres.
pub(crate) const RANGE_M: [f32; 2] = [0.2, 4.0];

/// What views hold: three levels of each pyramid.
pub(crate) const VIEW_OPTIONS: ViewOptions = ViewOptions {
    depth_range_m: RANGE_M,
    bilateral_passes: 0,
    levels: 3,
    vertices: None,
    observation_weights: false,
    colour_levels: 3,
};

/// A map on the device and what fills it.
#[derive(Debug)]
pub(crate) struct Fusion {
    pub(crate) map: BlockMap,
    pub(crate) view: View,
    pub(crate) calibration: Calibration,
    pub(crate) view_options: ViewOptions,
    pub(crate) options: IntegrateOptions,
}

impl Fusion {
    /// An empty map with voxels of a size, a truncation band of four voxels, and so many blocks.
    pub(crate) fn new(gpu: &Gpu, camera: Intrinsics, voxel_size_m: f32, colour: bool, blocks: u32) -> Self {
        Self::with_calibration(gpu, one_camera(camera), voxel_size_m, colour, blocks)
    }

    /// The same, with a calibration.
    pub(crate) fn with_calibration(
        gpu: &Gpu,
        calibration: Calibration,
        voxel_size_m: f32,
        colour: bool,
        blocks: u32,
    ) -> Self {
        Self::of_kind(gpu, calibration, voxel_size_m, VoxelKind { colour, ..VoxelKind::default() }, blocks)
    }

    /// The same, with voxels of a kind.
    pub(crate) fn of_kind(
        gpu: &Gpu,
        calibration: Calibration,
        voxel_size_m: f32,
        kind: VoxelKind,
        blocks: u32,
    ) -> Self {
        let view_options = ViewOptions { observation_weights: kind.confidence, ..VIEW_OPTIONS };
        let layout = MapLayout { voxel_size_m, truncation_m: 4.0 * voxel_size_m, kind };
        Self {
            map: BlockMap::new(&gpu.device, layout, blocks).expect("a small map fits"),
            view: View::new(&gpu.device, &calibration, &view_options),
            calibration,
            view_options,
            options: OPTIONS,
        }
    }

    /// Takes a frame over and allocates; returns the frame's record.
    pub(crate) fn allocate(&mut self, gpu: &Gpu, frame: &Frame, world_from_camera: &Se3) -> FrameRecord {
        let camera = self.calibration.depth;
        let margin_m = self.map.layout().truncation_m;
        self.map.lay_grid(&camera, world_from_camera, RANGE_M[1], margin_m).expect("a small view fits");
        let mut recorder = Recorder::new(&gpu.device);
        gpu.view.record(&mut recorder, &mut self.view, frame, &self.view_options).expect("the sizes are right");
        gpu.allocate.record(&mut recorder, &self.map, &self.view, world_from_camera);
        let reader = self.map.record_counters(&mut recorder);
        let _untimed = recorder.submit();
        reader.read(&gpu.device).expect("the device answers")
    }

    /// Lists the visible blocks and fuses the view into them.
    pub(crate) fn integrate(&mut self, gpu: &Gpu, world_from_camera: &Se3) {
        let mut recorder = Recorder::new(&gpu.device);
        self.record_visible(gpu, &mut recorder, world_from_camera);
        gpu.integrate.record(&mut recorder, &self.map, &self.view, &self.calibration, world_from_camera, &self.options);
        let _untimed = recorder.submit();
    }

    fn record_visible(&self, gpu: &Gpu, recorder: &mut Recorder, world_from_camera: &Se3) {
        let camera = &self.calibration.depth;
        gpu.visible.record(recorder, &self.map, camera, world_from_camera, RANGE_M[0], RANGE_M[1]);
    }

    /// Allocates and fuses a frame.
    pub(crate) fn fuse(&mut self, gpu: &Gpu, frame: &Frame, world_from_camera: &Se3) -> FrameRecord {
        let record = self.allocate(gpu, frame, world_from_camera);
        self.integrate(gpu, world_from_camera);
        record
    }

    /// Lays the grid around a view and casts it: ranges, points and normals.
    pub(crate) fn cast(&mut self, gpu: &Gpu, camera: Intrinsics, world_from_camera: &Se3) -> RaycastImage {
        let margin_m = self.map.layout().truncation_m;
        self.map.lay_grid(&camera, world_from_camera, RANGE_M[1], margin_m).expect("a small view fits");
        let image = RaycastImage::new(&gpu.device, camera).expect("a small image");
        let mut recorder = Recorder::new(&gpu.device);
        gpu.allocate.fill_grid(&mut recorder, &self.map);
        gpu.visible.record(&mut recorder, &self.map, &camera, world_from_camera, RANGE_M[0], RANGE_M[1]);
        gpu.ranges.record(&mut recorder, &self.map, &image, world_from_camera);
        gpu.raycast.record(&mut recorder, &self.map, &image, world_from_camera, RANGE_M);
        gpu.normals.record(&mut recorder, &image, world_from_camera);
        let _untimed = recorder.submit();
        image
    }

    /// Keys of all blocks by block index; none may be free.
    pub(crate) fn keys(&self) -> Vec<BlockKey> {
        let keys = self.map.read_keys().expect("the device answers");
        keys.into_iter().map(|k| k.expect("no block is free")).collect()
    }

    /// The visible list.
    pub(crate) fn visible(&self, gpu: &Gpu) -> Vec<u32> {
        self.map.read_visible(&gpu.device).expect("the device answers")
    }

    /// The whole map, read back.
    pub(crate) fn read(&self) -> reference::Map {
        let layout = self.map.layout();
        let mut map = reference::Map::new(layout.voxel_size_m, layout.truncation_m);
        for (key, index) in self.map.read_keys().expect("the device answers").into_iter().zip(0..) {
            let Some(key) = key else { continue };
            let words = self.map.read_block(index).expect("the device answers");
            let block = reference::Block::from_words(layout.kind, &words);
            let before = map.blocks.insert(key.position, block);
            assert!(before.is_none(), "two blocks at {}", key.position);
        }
        map
    }
}

/// An image's points or normals (w is 0 where there is none) as the references take them.
pub(crate) fn to_reference(image: &Image<[f32; 4]>) -> Image<Option<DVec3>> {
    Image::from_fn(image.width(), image.height(), |x, y| {
        let [px, py, pz, w] = image[(x, y)].map(f64::from);
        (w > 0.0).then(|| DVec3::new(px, py, pz))
    })
}

/// The value below which a share of all values lies.
pub(crate) fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    assert!(!values.is_empty(), "no values");
    values.sort_by(f64::total_cmp);
    values[((values.len() - 1) as f64 * share) as usize]
}

/// How far single precision may take a list of sums away from the reference's.
#[derive(Clone, Debug)]
pub(crate) struct Slack(Vec<f64>);

impl Slack {
    /// Of what is summed up, roundings of the summands and of up to 200 additions in a row (6e-8 each) lose no more.
    pub(crate) const SHARE: f64 = 1e-5;

    /// Sums of nothing, which are exact.
    pub(crate) fn new(sums: usize) -> Self {
        Self(vec![0.0; sums])
    }

    /// A summand is the expected one, or, where rounding decides, one of some others.
    pub(crate) fn may_be(&mut self, expected: &[f64], others: impl Iterator<Item = Vec<f64>>) {
        let mut most = vec![0.0_f64; self.0.len()];
        for other in others {
            for ((most, a), b) in most.iter_mut().zip(expected).zip(&other) {
                *most = most.max((a - b).abs());
            }
        }
        self.add(&most);
    }

    /// A summand is uncertain by so much; numbers left out at the end are exact.
    pub(crate) fn add(&mut self, summand: &[f64]) {
        for (slack, more) in self.0.iter_mut().zip(summand) {
            *slack += more;
        }
    }

    /// Checks sums, numbered as they stand in the list.
    pub(crate) fn check(&self, found: &[f64], expected: &[f64]) -> Result<(), TestCaseError> {
        for (i, ((found, expected), slack)) in found.iter().zip(expected).zip(&self.0).enumerate() {
            prop_assert!(
                (found - expected).abs() <= *slack,
                "number {i}: {found} but {expected}, give or take {slack}"
            );
        }
        Ok(())
    }
}
