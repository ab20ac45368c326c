//! What robots ask of a map while it grows: distances along a path, what has changed, and meshes of just that.
//!
//! The map's blocks may lie on the device, in the host's store, or on their way there; what is answered here takes all of them
//! into account, and leaves each where it is.

use std::collections::{BTreeSet, HashMap};

use glam::{DVec3, Vec3};
use itm_core::Mesh;
use itm_core::sample::{Cell, Sample, block_of, distance_in_block};
use itm_core::voxel::BlockKey;
use itm_gpu::query::Query;
use itm_gpu::{BlockMap, Device, MapLayout};

use crate::chunked_mesh::mesh_some;
use crate::live::LiveMap;
use crate::source::BlockSource;
use crate::{Error, MeshOptions, Slam};

/// Points that are answered at a time on the host, which bounds the blocks in its memory.
const HOST_POINTS_AT_ONCE: usize = 4096;

/// The stages that answer, and the map for parts that are meshed.
#[derive(Debug)]
pub(crate) struct Questions {
    query: Query,
    part: BlockMap,
}

impl Questions {
    fn new(device: &Device, layout: MapLayout) -> Result<Self, Error> {
        Ok(Self { query: Query::new(device), part: BlockMap::new(device, layout, 1)? })
    }

    /// What a submap says of points in its frame.
    fn of_submap(&self, slam: &Slam, submap: u16, points: &[Vec3]) -> Result<Vec<Option<Sample>>, Error> {
        // Of handles.
        let mut map = slam.mapper.map.clone();
        map.look_at(submap);
        let mut samples = self.query.run(&map, points)?;
        let mut blocks = slam.mapper.live_map()?;
        if !blocks.is_on_device() {
            blocks.answer(submap, points, &mut samples)?;
        }
        Ok(samples)
    }
}

impl LiveMap<'_> {
    /// Answers the points for which the device lacks a block, or a part of one, that the host has.
    fn answer(&mut self, submap: u16, points: &[Vec3], samples: &mut [Option<Sample>]) -> Result<(), Error> {
        let MapLayout { voxel_size_m, truncation_m, kind } = self.layout();
        let key = |position| BlockKey { submap, position };
        let mut asked = Vec::new();
        for (index, point) in points.iter().enumerate() {
            let cell = Cell::around(*point, voxel_size_m);
            asked.extend(cell.filter(|cell| cell.blocks().any(|b| self.is_on_host(key(b)))).map(|cell| (index, cell)));
        }
        for some in asked.chunks(HOST_POINTS_AT_ONCE) {
            let needed: BTreeSet<[u32; 2]> =
                some.iter().flat_map(|(_, cell)| cell.blocks()).map(|position| key(position).pack()).collect();
            let keys: Vec<BlockKey> = needed.iter().copied().map(BlockKey::unpack).collect();
            let mut words = vec![0; keys.len() * kind.block_words()];
            self.read(&keys, &mut words)?;
            let blocks: HashMap<[u32; 2], &[u32]> =
                needed.into_iter().zip(words.chunks_exact(kind.block_words())).collect();
            for (index, cell) in some {
                let voxels = cell.voxels().map(|voxel| {
                    let block = blocks.get(&key(block_of(voxel)).pack());
                    block.map_or((1.0, 0), |words| distance_in_block(kind, words, voxel))
                });
                samples[*index] = cell.interpolate(voxels, voxel_size_m, truncation_m);
            }
        }
        Ok(())
    }
}

impl Slam {
    /// The signed distance of each point (world frame, metres) from the nearest surface, in metres: positive in front of
    /// surfaces, negative behind them. Blocks that have left the device are asked too. Waits.
    ///
    /// `None` where one of the eight voxels around the point was never seen, and where the point is no number or out of the
    /// map's reach. With several submaps it is the mean of what they say. The map keeps blocks around surfaces only: there is no answer in free space that is further from all
    /// surfaces than their blocks reach either, nor behind a surface beyond the truncation band. Distances are truncated: within
    /// the blocks, what is further than `map.truncation_m` from a surface has that value. They were measured along the
    /// cameras' rays, and are therefore rather too large in front of surfaces that were seen from the side only.
    ///
    /// ```no_run
    /// # use itm_slam::{Error, Slam};
    /// # fn follow(slam: &mut Slam) -> Result<(), Error> {
    /// use glam::Vec3;
    ///
    /// let path: Vec<Vec3> = (0..100).map(|i| Vec3::new(0.0, 0.0, 0.02 * i as f32)).collect();
    /// let distances = slam.distances(&path)?;
    /// let clear = distances.iter().take_while(|distance| distance.is_none_or(|metres| metres > 0.015)).count();
    /// println!("{clear} of {} points lie before the first surface", path.len());
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// Where the map is one of surfels, the device fails or the host's store cannot be read.
    pub fn distances(&mut self, points: &[Vec3]) -> Result<Vec<Option<f32>>, Error> {
        Ok(self.samples(points)?.into_iter().map(|sample| Some(sample?.distance_m)).collect())
    }

    /// The same with gradients: the derivative of the distance with respect to the point, without unit, which points away from
    /// the surface and has a length of about one within the band and zero beyond it. It is the trilinear interpolant's own
    /// derivative, so that it fits the distances exactly, and jumps by what the surface bends where a point passes from one cube
    /// of voxels to the next.
    ///
    /// ```no_run
    /// # use itm_slam::{Error, Slam};
    /// # fn push_away(slam: &mut Slam, points: &mut [glam::Vec3]) -> Result<(), Error> {
    /// let samples = slam.samples(points)?;
    /// for (point, sample) in points.iter_mut().zip(samples) {
    ///     if let Some(sample) = sample {
    ///         *point += (0.015 - sample.distance_m).max(0.0) * sample.gradient;
    ///     }
    /// }
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// As [`Slam::distances`].
    pub fn samples(&mut self, points: &[Vec3]) -> Result<Vec<Option<Sample>>, Error> {
        self.check_voxels("distances")?;
        self.ask(|questions, slam| {
            let poses = slam.submap_poses();
            if let [(submap, _)] = poses[..] {
                return questions.of_submap(slam, submap, points);
            }
            let mut sums = vec![(0.0_f64, DVec3::ZERO, 0.0_f64); points.len()];
            for (submap, world_from_submap) in poses {
                let submap_from_world = world_from_submap.inverse();
                let there = |point: &Vec3| submap_from_world.transform_point(point.as_dvec3()).as_vec3();
                let seen = questions.of_submap(slam, submap, &points.iter().map(there).collect::<Vec<_>>())?;
                for ((distance, gradient, count), sample) in sums.iter_mut().zip(seen) {
                    let Some(sample) = sample else { continue };
                    *distance += f64::from(sample.distance_m);
                    *gradient += world_from_submap.transform_vector(sample.gradient.as_dvec3());
                    *count += 1.0;
                }
            }
            let mean = |(distance, gradient, count): (f64, DVec3, f64)| {
                let of_all =
                    || Sample { distance_m: (distance / count) as f32, gradient: (gradient / count).as_vec3() };
                (count > 0.0).then(of_all)
            };
            Ok(sums.into_iter().map(mean).collect())
        })
    }

    /// Frames that [`Slam::process`] and [`Slam::place`] have taken in so far, fused or not, those before a session was saved
    /// included. What [`Slam::changed_since`] counts by: a frame's own index is the caller's, and may jump.
    pub fn frames(&self) -> u64 {
        self.mapper.frames()
    }

    /// All blocks of the map, wherever they lie, in the order of their packed keys. Waits.
    ///
    /// # Errors
    /// Where the map is one of surfels, or the device fails.
    pub fn blocks(&mut self) -> Result<Vec<BlockKey>, Error> {
        self.check_voxels("blocks")?;
        self.mapper.read_moved()?;
        Ok(self.mapper.live_map()?.keys())
    }

    /// The blocks that changed after the first so many frames ([`Slam::frames`]), in the order of their packed keys, wherever
    /// they lie now: those that were in the view of a frame that was fused, whether or not one of their voxels became another,
    /// and those that came back to the device and were merged there with what had been fused meanwhile. A change of place alone
    /// is none. Waits.
    ///
    /// Blocks that are gone, because they held nothing any more or `map.swapping` is `delete`, are not named: whoever keeps
    /// something by block looks for them in [`Slam::blocks`]. Blocks of a map that a session began in ([`Slam::in_map`]) count
    /// once a frame changes them.
    ///
    /// # Errors
    /// Where the map is one of surfels, `map.track_changes` is off, or the device fails.
    pub fn changed_since(&mut self, frames: u64) -> Result<Vec<BlockKey>, Error> {
        self.check_voxels("blocks")?;
        if !self.settings.map.track_changes {
            return Err(Error::ChangesNotTracked);
        }
        self.mapper.read_moved()?;
        let since = u32::try_from(frames).unwrap_or(u32::MAX);
        let mut found: BTreeSet<[u32; 2]> = BTreeSet::new();
        found.extend(self.mapper.map.read_changed_since(since)?.into_iter().map(|(key, _)| key.pack()));
        let stored = self.mapper.swapped.iter().flat_map(|swapped| &swapped.changed);
        found.extend(stored.filter(|(_, changed)| **changed > since).map(|(key, _)| *key));
        for left in self.mapper.moved().filter_map(|moved| moved.left.as_ref()) {
            let both = left.keys.iter().zip(&left.changed);
            found.extend(both.filter(|(_, changed)| **changed > since).map(|(key, _)| key.pack()));
        }
        Ok(found.into_iter().map(BlockKey::unpack).collect())
    }

    /// The surface in some blocks as a mesh (metres, in the frame of the blocks' submap, which is the world's where there is one
    /// submap; ask for one submap's at a time): the triangles of just their cells, wherever the blocks and
    /// those around them lie. Keys of blocks that are not there are passed over. Device memory for the blocks and those around
    /// them, at most that of [`MeshOptions::max_blocks`] by default, is kept for the next time. Waits.
    ///
    /// A cell reads voxels beyond its own block, so whoever keeps a mesh block by block makes those of
    /// [`crate::with_neighbours`] anew:
    ///
    /// ```no_run
    /// # use itm_slam::{Error, Slam, with_neighbours};
    /// # fn follow(slam: &mut Slam) -> Result<(), Error> {
    /// let before = slam.frames();
    /// // … some frames later:
    /// let changed = with_neighbours(&slam.changed_since(before)?);
    /// let mesh = slam.mesh_of(&changed)?;
    /// println!("{} blocks have {} triangles now", changed.len(), mesh.triangles.len());
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// Where the map is one of surfels, the device fails, the host's store cannot be read, or there are more vertices than 32 bits can number.
    pub fn mesh_of(&mut self, keys: &[BlockKey]) -> Result<Mesh, Error> {
        self.check_voxels("blocks")?;
        self.ask(|questions, slam| {
            let mut blocks = slam.mapper.live_map()?;
            let options = MeshOptions::default();
            mesh_some(&slam.extract, &mut questions.part, &mut blocks, keys, &options, &mut |_, _| ())
        })
    }

    fn check_voxels(&self, what: &'static str) -> Result<(), Error> {
        if self.mapper.surfels.is_some() { Err(Error::NeedsVoxels { what }) } else { Ok(()) }
    }

    fn ask<T>(&mut self, answer: impl FnOnce(&mut Questions, &Self) -> Result<T, Error>) -> Result<T, Error> {
        self.mapper.read_moved()?;
        let mut questions = match self.questions.take() {
            Some(questions) => questions,
            None => Questions::new(&self.device, *self.mapper.map.layout())?,
        };
        let answer = answer(&mut questions, self);
        self.questions = Some(questions);
        answer
    }
}
