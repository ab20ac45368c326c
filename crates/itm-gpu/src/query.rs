//! Stage `query`: signed distances and their gradients at points anywhere in the map.

use std::sync::OnceLock;

use glam::Vec3;
use itm_core::sample::{Cell, Sample};
use itm_core::voxel::DistanceKind;
use itm_shaders::query;

use crate::raycast::page_features;
use crate::recorder::{Groups, Pipeline};
use crate::{BlockMap, Device, Error, Recorder};

/// Points that are asked for at a time: 16 MiB of them, and as much again of answers.
const POINTS_AT_ONCE: usize = 1 << 20;
/// Samples from here on are none; see `query.wgsl`.
const UNSEEN_FROM: f32 = 1e38;

/// The stage's pipelines, compiled when first needed: one for each kind of distance and number of pages.
#[derive(Debug)]
pub struct Query {
    device: Device,
    variants: [[OnceLock<Pipeline>; 4]; 2],
}

impl Query {
    /// Prepares the stage.
    pub fn new(device: &Device) -> Self {
        Self { device: device.clone(), variants: Default::default() }
    }

    /// The signed distance and its gradient at each of the points (world frame, metres), by trilinear interpolation between the
    /// eight voxels around it: see [`Cell::interpolate`]. `None` where one of those was never seen, and where the point is no
    /// number or out of the map's reach. Waits.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn run(&self, map: &BlockMap, points: &[Vec3]) -> Result<Vec<Option<Sample>>, Error> {
        let mut samples = Vec::with_capacity(points.len());
        for some in points.chunks(POINTS_AT_ONCE) {
            self.append(map, some, &mut samples)?;
        }
        Ok(samples)
    }

    fn append(&self, map: &BlockMap, points: &[Vec3], samples: &mut Vec<Option<Sample>>) -> Result<(), Error> {
        let voxel_size_m = map.layout().voxel_size_m;
        let within = |point: &Vec3| Cell::around(*point, voxel_size_m).is_some();
        // What cannot be asked for asks for the origin, in vain.
        let asked = points.iter().map(|point| if within(point) { point.extend(0.0) } else { glam::Vec4::ZERO });
        let asked: Vec<[f32; 4]> = asked.map(|point| point.to_array()).collect();
        let bytes = size_of_val(asked.as_slice()) as u64;
        let wanted = self.device.storage("query points", bytes);
        self.device.queue.write_buffer(&wanted, 0, bytemuck::cast_slice(&asked));
        let found = self.device.storage("query samples", bytes);
        let mut recorder = Recorder::new(&self.device);
        self.record(&mut recorder, map, &wanted, &found, points.len() as u32);
        let _untimed = recorder.submit();
        let found: Vec<[f32; 4]> = self.device.read(&found, 0, bytes)?;
        samples.extend(points.iter().zip(found).map(|(point, [x, y, z, distance_m])| {
            (distance_m < UNSEEN_FROM && within(point)).then_some(Sample { distance_m, gradient: Vec3::new(x, y, z) })
        }));
        Ok(())
    }

    fn record(
        &self,
        recorder: &mut Recorder,
        map: &BlockMap,
        points: &wgpu::Buffer,
        samples: &wgpu::Buffer,
        count: u32,
    ) {
        recorder.stage("query");
        let pages = map.distances();
        let features = [map.distance_features(), page_features(pages.len())].concat();
        let of_kind = &self.variants[usize::from(map.layout().kind.distance == DistanceKind::F32)];
        let pipeline =
            of_kind[pages.len() - 1].get_or_init(|| Pipeline::new(&self.device, &query::PASS, &features, &[]));
        let bindings = query::Bindings {
            params: query::Params { map: map.params(), count, unused_a: 0, unused_b: [0; 2] },
            points,
            samples,
            keys: &map.keys,
            hash: &map.hash,
            distance0: &pages[0],
            distance1: pages.get(1),
            distance2: pages.get(2),
            distance3: pages.get(3),
        };
        recorder.dispatch(pipeline, &bindings, Groups::linear(count.into(), 64));
    }
}
