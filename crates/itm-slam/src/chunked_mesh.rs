//! Meshing a map in parts, so that device memory is bounded by the part and not by the map.

use std::collections::{HashMap, HashSet};

use glam::IVec3;
use itm_core::Mesh;
use itm_core::voxel::{BLOCK_SIDE, BlockKey};
use itm_gpu::mesh::{Extract, LatticeEdge, Options, Part};
use itm_gpu::{BlockMap, Device};

use crate::Error;
use crate::chunks::{Chunks, around};
use crate::source::{BlockSource, upload};

/// How a map is meshed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MeshOptions {
    /// Only cells all of whose voxels have at least this weight count; zero is taken as one.
    pub min_weight: u32,
    /// Blocks that lie on the device at a time, those around a part included; at least 27.
    pub max_blocks: u32,
}

impl Default for MeshOptions {
    fn default() -> Self {
        Self { min_weight: 1, max_blocks: 16_384 }
    }
}

/// Meshes all blocks of a source, chunk by chunk: each is uploaded with the blocks around it, and the vertices on the borders
/// between chunks become one, so that the mesh has the same vertices and triangles as one made of all blocks at once, if in
/// another order. Each submap is meshed on its own, in its own coordinates. `progress` is told how many of how many blocks
/// are done.
///
/// # Memory
/// On the device: [`MeshOptions::max_blocks`] blocks (by default 16,384: 32 MiB for each word of a voxel), and what
/// [`itm_gpu::mesh`] takes for so many. On the host: the mesh, 4096 blocks on their way to the device, about 70 bytes for each
/// block of the source, and 40 for each vertex on a border that a later chunk shares.
///
/// # Errors
/// Where the source cannot be read, the device fails, or there are more vertices than 32 bits can number.
pub fn mesh_in_chunks(
    device: &Device,
    source: &mut dyn BlockSource,
    options: &MeshOptions,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<Mesh, Error> {
    let chunks = Chunks::new(source.keys(), options.max_blocks);
    let mut map = BlockMap::new(device, source.layout(), 1)?;
    mesh_chunks(&Extract::new(device), &mut map, source, &chunks, options, progress)
}

/// Meshes some blocks of a source: the triangles of their cells alone, for which the blocks around them are read too. Keys that
/// the source does not have, and repeated ones, are passed over. So a mesh can follow a map that changes: see [`with_neighbours`].
/// All else is as for [`mesh_in_chunks`].
///
/// # Errors
/// As [`mesh_in_chunks`].
pub(crate) fn mesh_blocks(
    device: &Device,
    source: &mut dyn BlockSource,
    keys: &[BlockKey],
    options: &MeshOptions,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<Mesh, Error> {
    let mut map = BlockMap::new(device, source.layout(), 1)?;
    mesh_some(&Extract::new(device), &mut map, source, keys, options, progress)
}

/// The same with a stage and a map for the parts, which are kept from call to call.
pub(crate) fn mesh_some(
    extract: &Extract,
    map: &mut BlockMap,
    source: &mut dyn BlockSource,
    keys: &[BlockKey],
    options: &MeshOptions,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<Mesh, Error> {
    let all: HashSet<[u32; 2]> = source.keys().into_iter().map(BlockKey::pack).collect();
    let mut wanted = HashSet::new();
    let own: Vec<BlockKey> =
        keys.iter().filter(|key| all.contains(&key.pack()) && wanted.insert(key.pack())).copied().collect();
    let others: HashSet<_> =
        own.iter().flat_map(|key| around(*key)).filter(|key| all.contains(key) && !wanted.contains(key)).collect();
    mesh_chunks(extract, map, source, &Chunks::among(own, others, options.max_blocks), options, progress)
}

/// Blocks and their 26 neighbours, each once: those whose meshes may be others after the blocks have changed, for a cell
/// reads voxels up to two beyond its own.
pub fn with_neighbours(keys: &[BlockKey]) -> Vec<BlockKey> {
    let mut seen = HashSet::new();
    keys.iter().flat_map(|key| around(*key)).filter(|key| seen.insert(*key)).map(BlockKey::unpack).collect()
}

fn mesh_chunks(
    extract: &Extract,
    map: &mut BlockMap,
    source: &mut dyn BlockSource,
    chunks: &Chunks,
    options: &MeshOptions,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<Mesh, Error> {
    let all = chunks.blocks() as u64;
    let mut joined = Joined::new(chunks, source.layout().voxel_size_m);
    let mut done = 0;
    for chunk in 0..chunks.len() {
        let blocks = chunks.with_surroundings(chunk);
        let own = chunks.own(chunk).len() as u32;
        map.forget_blocks();
        upload(source, &blocks, map)?;
        let options = Options { min_weight: options.min_weight, cells_of_first: Some(own), ..Options::default() };
        let part = extract.part(map, &options, &mut |step, steps| {
            progress(done + u64::from(own) * u64::from(step) / u64::from(steps.max(1)), all);
        })?;
        joined.append(&part, chunk)?;
        done += u64::from(own);
        progress(done, all);
    }
    Ok(joined.mesh)
}

/// A mesh that grows chunk by chunk.
struct Joined<'a> {
    chunks: &'a Chunks,
    voxel_size_m: f32,
    mesh: Mesh,
    /// Vertices that a later chunk may share.
    open: HashMap<(u16, LatticeEdge), u32>,
}

impl<'a> Joined<'a> {
    fn new(chunks: &'a Chunks, voxel_size_m: f32) -> Self {
        Self { chunks, voxel_size_m, mesh: Mesh::default(), open: HashMap::new() }
    }

    fn append(&mut self, part: &Part, chunk: usize) -> Result<(), Error> {
        let Some(submap) = self.chunks.own(chunk).first().map(|key| key.submap) else { return Ok(()) };
        let from = &part.mesh;
        let mut numbers = Vec::with_capacity(from.positions.len());
        for i in 0..from.positions.len() {
            let edge = part.edge(i, self.voxel_size_m);
            let last = self.last_chunk_at(submap, edge);
            let known = match last {
                None => None,
                Some(last) if last > chunk => self.open.get(&(submap, edge)).copied(),
                Some(_) => self.open.remove(&(submap, edge)),
            };
            let number = match known {
                Some(number) => number,
                None => {
                    let number = self.push(from, i)?;
                    if last.is_some_and(|last| last > chunk) {
                        self.open.insert((submap, edge), number);
                    }
                    number
                }
            };
            numbers.push(number);
        }
        self.mesh.triangles.extend(from.triangles.iter().map(|t| t.map(|v| numbers[v as usize])));
        Ok(())
    }

    /// Appends a vertex, and returns its number.
    fn push(&mut self, from: &Mesh, i: usize) -> Result<u32, Error> {
        let mesh = &mut self.mesh;
        let blocks = u32::try_from(self.chunks.blocks()).unwrap_or(u32::MAX);
        let too_large = || itm_gpu::Error::MeshTooLarge { blocks };
        let number = u32::try_from(mesh.positions.len()).map_err(|_| too_large())?;
        mesh.positions.push(from.positions[i]);
        mesh.normals.extend(from.normals.get(i));
        mesh.colours.extend(from.colours.get(i));
        mesh.weights.extend(from.weights.get(i));
        mesh.confidences.extend(from.confidences.get(i));
        Ok(number)
    }

    /// The last of the chunks whose cells touch an edge; `None` where there is only one.
    fn last_chunk_at(&self, submap: u16, edge: LatticeEdge) -> Option<usize> {
        let axis = usize::from(edge.axis);
        let (u, v) = (IVec3::AXES[(axis + 1) % 3], IVec3::AXES[(axis + 2) % 3]);
        let on_border = |along: IVec3| edge.voxel.dot(along).rem_euclid(BLOCK_SIDE) == 0;
        let (u, v) = (if on_border(u) { u } else { IVec3::ZERO }, if on_border(v) { v } else { IVec3::ZERO });
        if u == v {
            return None;
        }
        let cells = [edge.voxel, edge.voxel - u, edge.voxel - v, edge.voxel - u - v];
        let position = |cell: IVec3| cell.div_euclid(IVec3::splat(BLOCK_SIDE));
        let chunk = |cell| self.chunks.chunk_of(BlockKey { submap, position: position(cell) });
        let (first, last) = cells.into_iter().filter_map(chunk).fold((usize::MAX, 0), |(a, b), c| (a.min(c), b.max(c)));
        (first < last).then_some(last)
    }
}
