//! Stage `raycast`: the surface that each pixel sees (the report, section 3.4).

use std::sync::OnceLock;

use itm_core::voxel::DistanceKind;
use itm_core::{Image, Intrinsics, Se3};
use itm_shaders::raycast;

use crate::map::camera_params;
use crate::ranges::range_size;
use crate::recorder::{Groups, Pipeline};
use crate::{BlockMap, Device, Error, Recorder};

/// The map as seen from a pose: a range image, surface points and normals, at a camera's resolution.
#[derive(Debug)]
pub struct RaycastImage {
    camera: Intrinsics,
    pub(crate) ranges: wgpu::Buffer,
    pub(crate) points: wgpu::Buffer,
    pub(crate) normals: wgpu::Buffer,
}

impl RaycastImage {
    /// An image for a camera, empty until it is recorded.
    ///
    /// # Errors
    /// Where the device's buffers are too small for it.
    pub fn new(device: &Device, camera: Intrinsics) -> Result<Self, Error> {
        let [width, height] = range_size(&camera);
        let bytes = camera.pixels() as u64 * 16;
        let limit = device.capabilities().max_binding_bytes;
        if bytes > limit {
            return Err(Error::ImageTooLarge { width: camera.width, height: camera.height, limit });
        }
        Ok(Self {
            camera,
            ranges: device.storage("ranges", u64::from(width) * u64::from(height) * 8),
            points: device.storage("points", bytes),
            normals: device.storage("normals", bytes),
        })
    }

    /// The camera.
    pub fn camera(&self) -> &Intrinsics {
        &self.camera
    }

    /// Reads the points back: world coordinates in metres, and one plus the smallest weight of the eight voxels around
    /// (around the place from which the last refining step led there);
    /// all zero where a ray hits nothing. Waits. For tests, exports and pictures.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn read_points(&self, device: &Device) -> Result<Image<[f32; 4]>, Error> {
        self.read_image(device, &self.points)
    }

    /// Reads the normals back: unit vectors in the world frame, towards the camera, and 1; all zero where there is none.
    /// Waits. For tests, exports and pictures.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn read_normals(&self, device: &Device) -> Result<Image<[f32; 4]>, Error> {
        self.read_image(device, &self.normals)
    }

    /// Reads the range image back: for each 8x8 pixels the nearest and farthest depth at which they may see a surface,
    /// in metres. Waits. For tests, exports and pictures.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn read_ranges(&self, device: &Device) -> Result<Image<Option<[f32; 2]>>, Error> {
        let [width, height] = range_size(&self.camera);
        let words: Vec<[u32; 2]> = device.read(&self.ranges, 0, u64::from(width) * u64::from(height) * 8)?;
        // The nearest depth is kept as the complement of its bits; zeroed memory is an empty range.
        let range = |[near, far]: [u32; 2]| (far != 0).then(|| [f32::from_bits(!near), f32::from_bits(far)]);
        Ok(Image::new(width, height, words.into_iter().map(range).collect()).expect("as many values as pixels"))
    }

    fn read_image(&self, device: &Device, buffer: &wgpu::Buffer) -> Result<Image<[f32; 4]>, Error> {
        let values = device.read(buffer, 0, self.camera.pixels() as u64 * 16)?;
        Ok(Image::new(self.camera.width, self.camera.height, values).expect("as many values as pixels"))
    }
}

/// The features of a shader variant for so many pages.
pub(crate) fn page_features(pages: usize) -> &'static [&'static str] {
    &["pages2", "pages3", "pages4"][..pages.clamp(1, 4) - 1]
}

/// Pixels of an image for which rays are to be cast.
#[derive(Debug)]
pub struct RayList {
    /// Workgroups as an indirect dispatch takes them, the number of pixels, and those.
    pub(crate) words: wgpu::Buffer,
}

impl RayList {
    /// An empty list with room for so many.
    pub(crate) fn new(device: &Device, pixels: u64) -> Self {
        let words = device.storage("missing pixels", 16 + pixels * 4);
        device.queue.write_buffer(&words, 0, bytemuck::cast_slice(&[0_u32, 1, 1, 0]));
        Self { words }
    }

    pub(crate) fn record_clear(&self, recorder: &mut Recorder) {
        for word in [0, 3] {
            recorder.clear_word(&self.words, word);
        }
    }

    /// Reads the number of pixels back. Waits. For tests.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn read_len(&self, device: &Device) -> Result<usize, Error> {
        let words: Vec<u32> = device.read(&self.words, 0, 16)?;
        Ok(words[3] as usize)
    }
}

/// The stage's pipelines, compiled when first needed: one for each kind of distance, all pixels or a list, and number of pages.
#[derive(Debug)]
pub struct Raycast {
    device: Device,
    variants: [[[OnceLock<Pipeline>; 4]; 2]; 2],
}

impl Raycast {
    /// Prepares the stage.
    pub fn new(device: &Device) -> Self {
        Self { device: device.clone(), variants: Default::default() }
    }

    /// Records the stage for the image's camera at a pose, along the rays' ranges that `ranges` found.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        map: &BlockMap,
        image: &RaycastImage,
        world_from_camera: &Se3,
        depth_range_m: [f32; 2],
    ) {
        self.dispatch(recorder, map, image, None, world_from_camera, depth_range_m);
    }

    /// The same for the pixels of a list; the others stay as they are.
    pub fn record_listed(
        &self,
        recorder: &mut Recorder,
        map: &BlockMap,
        image: &RaycastImage,
        list: &RayList,
        world_from_camera: &Se3,
        depth_range_m: [f32; 2],
    ) {
        self.dispatch(recorder, map, image, Some(list), world_from_camera, depth_range_m);
    }

    fn dispatch(
        &self,
        recorder: &mut Recorder,
        map: &BlockMap,
        image: &RaycastImage,
        list: Option<&RayList>,
        world_from_camera: &Se3,
        depth_range_m: [f32; 2],
    ) {
        recorder.stage("raycast");
        let pages = map.distances();
        let listed: &[&str] = if list.is_some() { &["listed"] } else { &[] };
        let features = [map.distance_features(), listed, page_features(pages.len())].concat();
        let of_kind = &self.variants[usize::from(map.layout().kind.distance == DistanceKind::F32)];
        let pipeline = of_kind[usize::from(list.is_some())][pages.len() - 1]
            .get_or_init(|| Pipeline::new(&self.device, &raycast::PASS, &features, &[]));
        let bindings = raycast::Bindings {
            params: raycast::Params {
                camera: camera_params(&image.camera, depth_range_m),
                world_from_camera: world_from_camera.to_mat4().to_cols_array_2d(),
                map: map.params(),
                range_size: range_size(&image.camera),
                unused: [0; 2],
            },
            ranges: &image.ranges,
            points: &image.points,
            grid: &map.grid,
            distance0: &pages[0],
            distance1: pages.get(1),
            distance2: pages.get(2),
            distance3: pages.get(3),
            missing: list.map(|list| &list.words),
        };
        let size = (image.camera.width, image.camera.height);
        let groups = match list {
            Some(list) => Groups::Indirect(&list.words, 0),
            None => Groups::image(size, (8, 8)),
        };
        recorder.dispatch(pipeline, &bindings, groups);
    }
}
