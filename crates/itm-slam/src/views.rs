//! Pictures, depth and points of a map whose blocks do not all lie on the device.

use std::collections::HashSet;

use glam::{DVec2, DVec3, IVec3, Vec3};
use itm_core::voxel::{BEST_OBSERVATION, BLOCK_SIDE, BlockKey};
use itm_core::{ColourImage, Image, Intrinsics, ObservationWeight, PointCloud, Se3, Settings};
use itm_gpu::render::{Of, Render, Scale, Seen, Shading};
use itm_gpu::{BlockMap, Canvas, Device, MapLayout, RaycastImage, Recorder};

use crate::Error;
use crate::caster::Caster;
use crate::painting::check_camera;
use crate::source::{BlockSource, upload};

/// Looks at one submap of a map from any pose, with any camera.
///
/// The blocks in the view's frustum are uploaded; those that were in the one before stay, as long as both together are no
/// more than a bound. So a camera's way costs the blocks that come into view.
#[derive(Debug)]
pub struct MapViews {
    device: Device,
    submap: u16,
    max_blocks: u32,
    map: BlockMap,
    /// The blocks in `map`, and whether those are what the source has.
    held: HashSet<[u32; 2]>,
    current: Option<(RaycastImage, Se3)>,
    caster: Caster,
    render: Render,
}

impl MapViews {
    /// Prepares views of a submap of maps of such a layout, which keep `max_blocks` blocks on the device, or as many as one
    /// view needs where that is more.
    ///
    /// # Errors
    /// Where the device has no room.
    pub fn new(device: &Device, layout: MapLayout, submap: u16, max_blocks: u32) -> Result<Self, Error> {
        Ok(Self {
            device: device.clone(),
            submap,
            max_blocks,
            map: BlockMap::new(device, layout, 1)?,
            held: HashSet::new(),
            current: None,
            caster: Caster::new(device),
            render: Render::new(device),
        })
    }

    /// Casts the map as a camera sees it from a pose, up to a depth. What the other methods return is of this view. The source
    /// has to be the same one, unchanged, in all calls.
    ///
    /// # Errors
    /// Where the camera is none, the source cannot be read, the view reaches over more blocks than the device can index or hold,
    /// or the device fails.
    pub fn look(
        &mut self,
        source: &mut dyn BlockSource,
        camera: &Intrinsics,
        world_from_camera: &Se3,
        max_depth_m: f32,
    ) -> Result<(), Error> {
        check_camera(camera)?;
        let before = self.current.take().map(|(image, _)| image).filter(|image| image.camera() == camera);
        let image = match before {
            Some(image) => image,
            None => RaycastImage::new(&self.device, *camera)?,
        };
        let seen = self.seen_blocks(source, camera, world_from_camera, max_depth_m);
        let first = seen.iter().map(|key| key.position).reduce(IVec3::min).unwrap_or_default();
        let last = seen.iter().map(|key| key.position).reduce(IVec3::max).unwrap_or_default();
        // Refused before anything is uploaded.
        self.map.lay_grid_within(camera, world_from_camera, max_depth_m, [first, last])?;
        self.fetch(source, seen)?;
        let mut recorder = Recorder::new(&self.device);
        self.caster.look(&mut recorder, &self.map, &image, world_from_camera, max_depth_m);
        let _untimed = recorder.submit();
        self.current = Some((image, *world_from_camera));
        Ok(())
    }

    /// Blocks that lie on the device.
    pub fn blocks(&self) -> usize {
        self.held.len()
    }

    /// A picture of the view; pixels that show nothing have alpha 0, and so have all before the first view.
    ///
    /// # Errors
    /// Where the device fails.
    pub fn picture(&self, shading: Shading, scale: &Scale) -> Result<ColourImage, Error> {
        let Some((image, pose)) = &self.current else { return Ok(ColourImage::filled(0, 0, [0; 4])) };
        Ok(self.render.run(&self.seen(image, pose), shading, scale)?)
    }

    /// Paints the view onto a canvas of its camera's size, in place of what was there, with the map where it lies in the world.
    pub(crate) fn paint_placed(&self, world_from_map: &Se3, shading: Shading, scale: &Scale, canvas: &Canvas) {
        let mut recorder = Recorder::new(&self.device);
        canvas.clear(&mut recorder);
        if let Some((image, pose)) = &self.current {
            let seen = Seen { world_from_map, ..self.seen(image, pose) };
            self.render.paint(&mut recorder, &seen, shading, scale, canvas);
        }
        canvas.show(&mut recorder);
        let _untimed = recorder.submit();
    }

    fn seen<'a>(&'a self, image: &'a RaycastImage, pose: &'a Se3) -> Seen<'a> {
        Seen { image, map_from_camera: pose, world_from_map: &Se3::IDENTITY, of: Of::Voxels(&self.map) }
    }

    /// Depth along the optical axis in millimetres; 0 where there is none, or more than 65.534 m.
    ///
    /// # Errors
    /// Where the device fails.
    pub fn depth_millimetres(&self) -> Result<Image<u16>, Error> {
        let Some((image, pose)) = &self.current else { return Ok(Image::filled(0, 0, 0)) };
        Ok(depth_millimetres(&image.read_points(&self.device)?, pose))
    }

    /// The visible surface: a point for each pixel that sees one and has a normal, row by row. Colours and confidences where
    /// the map has them; weights are the smallest of the voxels around a point.
    ///
    /// # Errors
    /// Where the device fails.
    pub fn points(&self) -> Result<PointCloud, Error> {
        let mut cloud = PointCloud::default();
        let Some((image, pose)) = &self.current else { return Ok(cloud) };
        let kind = self.map.layout().kind;
        let (points, normals) = (image.read_points(&self.device)?, image.read_normals(&self.device)?);
        let colours = kind
            .colour
            .then(|| self.render.run(&self.seen(image, pose), Shading::Colour, &Scale::default()))
            .transpose()?;
        for (i, (&[x, y, z, observed], &[nx, ny, nz, known])) in points.data().iter().zip(normals.data()).enumerate() {
            if observed == 0.0 || known == 0.0 {
                continue;
            }
            cloud.positions.push(Vec3::new(x, y, z));
            cloud.normals.push(Vec3::new(nx, ny, nz));
            cloud.colours.extend(colours.as_ref().map(|c| c.data()[i]).map(|[r, g, b, _]| [r, g, b]));
            cloud.weights.push(observed - 1.0);
            cloud.confidences.extend(kind.confidence.then_some(known - 2.0));
        }
        Ok(cloud)
    }

    /// The blocks of a view, and those that interpolation in it reaches into.
    fn seen_blocks(
        &self,
        source: &dyn BlockSource,
        camera: &Intrinsics,
        world_from_camera: &Se3,
        max_depth_m: f32,
    ) -> Vec<BlockKey> {
        let voxel_m = f64::from(self.map.layout().voxel_size_m);
        let frustum = Frustum::new(camera, world_from_camera, max_depth_m.into());
        // With the voxels that interpolation reaches for.
        let radius = (0.5 * f64::from(BLOCK_SIDE) + 1.5) * voxel_m * 3.0_f64.sqrt();
        let middle = |key: &BlockKey| (key.position * BLOCK_SIDE).as_dvec3() + 0.5 * f64::from(BLOCK_SIDE - 1);
        let mut seen = source.keys();
        seen.retain(|key| key.submap == self.submap && frustum.meets(middle(key) * voxel_m, radius));
        seen
    }

    /// Brings the blocks of a view to the device that are not there.
    fn fetch(&mut self, source: &mut dyn BlockSource, seen: Vec<BlockKey>) -> Result<(), Error> {
        let mut new: Vec<BlockKey> = seen.iter().filter(|key| !self.held.contains(&key.pack())).copied().collect();
        if !self.held.is_empty() && self.held.len() + new.len() > self.max_blocks as usize {
            self.held.clear();
            self.map.forget_blocks();
            new = seen;
        }
        let added = upload(source, &new, &mut self.map);
        if added.is_err() {
            // Some may have come.
            self.held.clear();
            self.map.forget_blocks();
        } else {
            self.held.extend(new.iter().map(|key| key.pack()));
        }
        added
    }
}

/// Depth in millimetres of points as a camera saw them from a pose; 0 where there is none.
pub(crate) fn depth_millimetres(points: &Image<[f32; 4]>, world_from_camera: &Se3) -> Image<u16> {
    let camera_from_world = world_from_camera.inverse();
    Image::from_fn(points.width(), points.height(), |x, y| {
        let [px, py, pz, observed] = points[(x, y)];
        let z = camera_from_world.transform_point(Vec3::new(px, py, pz).as_dvec3()).z;
        let millimetres = (z * 1e3).round();
        // The largest value means 'no measurement', as 0 does.
        let there = observed > 0.0 && millimetres > 0.0 && millimetres < f64::from(u16::MAX);
        if there { millimetres as u16 } else { 0 }
    })
}

/// What a camera sees up to a depth.
struct Frustum {
    camera_from_world: Se3,
    /// Inward unit normals of the four sides, through the camera's centre (camera frame).
    sides: [DVec3; 4],
    far_m: f64,
}

impl Frustum {
    fn new(camera: &Intrinsics, world_from_camera: &Se3, far_m: f64) -> Self {
        let (right, bottom) = (f64::from(camera.width) - 0.5, f64::from(camera.height) - 0.5);
        let corners = [(-0.5, -0.5), (right, -0.5), (right, bottom), (-0.5, bottom)]
            .map(|(x, y)| camera.unproject(DVec2::new(x, y), 1.0));
        let middle = corners.iter().sum::<DVec3>();
        let sides = std::array::from_fn(|i| {
            let normal = corners[i].cross(corners[(i + 1) % 4]).normalize();
            if normal.dot(middle) < 0.0 { -normal } else { normal }
        });
        Self { camera_from_world: world_from_camera.inverse(), sides, far_m }
    }

    /// Whether a sphere (world frame) may reach into it.
    fn meets(&self, centre: DVec3, radius: f64) -> bool {
        let p = self.camera_from_world.transform_point(centre);
        p.z + radius > 0.0 && p.z - radius < self.far_m && self.sides.iter().all(|side| side.dot(p) > -radius)
    }
}

/// The largest weight that fusion gives a voxel.
pub(crate) fn full_weight(settings: &Settings) -> u16 {
    let best = match settings.map.observation_weight {
        ObservationWeight::Constant => 1,
        ObservationWeight::Noise => BEST_OBSERVATION,
    };
    settings.map.max_weight.saturating_mul(best)
}

/// The confidence, or number of observations, that a point can have at most: the upper end of the scale of
/// [`Shading::Confidence`].
pub fn full_confidence(settings: &Settings) -> f32 {
    if settings.map.confidence { settings.map.max_weight.into() } else { full_weight(settings).into() }
}
