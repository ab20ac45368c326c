//! Stage `mesh`: the whole map's surface as triangles, by marching cubes.
//!
//! Cells span the voxels of all blocks, so that vertices are shared across blocks too and a closed object gives a
//! watertight mesh. The number of each vertex and triangle comes from prefix sums: the same map, block for block, gives
//! the same mesh, vertex for vertex.
//!
//! # Memory
//! For each block of the map 252 bytes stay on the device while the mesh is made (one bit for each edge, and counts).
//! All else is made for a range of blocks at a time: for each block of the range 5.8 kB (with colour 11.2 kB), which is
//! 12 MB (23 MB) for the default of 2048 blocks; and the range's real output, up to 16 MiB each of vertices and
//! triangles, and as much again to read it back. A range ends early rather than exceed that.

mod cases;

use std::sync::OnceLock;

use bytemuck::{Pod, Zeroable};
use glam::{IVec3, Vec3};
use itm_core::Mesh;
use itm_core::voxel::{DistanceKind, VoxelKind};
use itm_shaders::mesh;

pub(crate) use cases::{edge_start, triangles as triangles_of_case};

use crate::map::Plane;
use crate::recorder::{Groups, Pipeline};
use crate::scan::{Scan, Total};
use crate::{BlockMap, Device, Error, Recorder};

// Per block, as `shared/edges.wgsl`, `shared/signs.wgsl` and `shared/padded.wgsl` lay them out.
const EDGE_BYTES: u64 = 54 * 4;
const SIGN_BYTES: u64 = 100 * 4;
const PADDED_BYTES: u64 = 1331 * 4;
const NEIGHBOUR_BYTES: u64 = 27 * 4;
/// Triangles are counted for each slice of a block.
const SLICES: u64 = 8;
const TRIANGLE_BYTES: u64 = 12;
/// What a range's vertices, and its triangles, may take: 341 blocks of the worst kind, tens of thousands of real ones.
const OUTPUT_BYTES: u64 = 16 << 20;

/// How a mesh is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Options {
    /// Only cells all of whose voxels have at least this weight count. Zero is taken as one: no surface lies where
    /// nothing was seen.
    pub min_weight: u32,
    /// Blocks that are meshed at a time; bounds the device memory that it takes. At least one, at most what the device
    /// can bind.
    pub blocks_per_range: u32,
    /// Only cells of so many blocks count, by index from 0; the others only lend their voxels. So a part of a map can be
    /// meshed with the blocks around it. By default all count.
    pub cells_of_first: Option<u32>,
}

impl Default for Options {
    fn default() -> Self {
        Self { min_weight: 1, blocks_per_range: 2048, cells_of_first: None }
    }
}

/// A mesh whose vertices know which edge of the voxels' lattice they lie on, so that parts can be joined there.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Part {
    /// The mesh.
    pub mesh: Mesh,
    /// A byte each, as `mesh/vertices.wgsl` writes it.
    edges: Vec<u8>,
}

/// An edge of the lattice of voxels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct LatticeEdge {
    /// The voxel that it starts from.
    pub voxel: IVec3,
    /// 0, 1 or 2: along x, y or z.
    pub axis: u8,
}

impl Part {
    /// The edge of the lattice on which a vertex lies, in a map of such voxels. The same edge has the same vertex, to the bit,
    /// wherever it is made from the same voxels.
    ///
    /// # Panics
    /// Where there is no such vertex.
    pub fn edge(&self, vertex: usize, voxel_size_m: f32) -> LatticeEdge {
        let (position, byte) = (self.mesh.positions[vertex].as_dvec3() / f64::from(voxel_size_m), self.edges[vertex]);
        let axis = usize::from(byte & 3);
        // On the lattice but for rounding; along the axis the vertex may lie on either end, so the byte decides.
        let mut voxel = position.round().as_ivec3();
        let middle = position[axis] - 0.5;
        let low = i32::from(byte >> 2);
        voxel[axis] = low + 8 * ((middle - f64::from(low)) / 8.0).round() as i32;
        LatticeEdge { voxel, axis: axis as u8 }
    }
}

/// The stage's pipelines.
#[derive(Debug)]
pub struct Extract {
    device: Device,
    neighbours: Pipeline,
    /// By kind of distance.
    signs: [OnceLock<Pipeline>; 2],
    mark: Pipeline,
    count: Pipeline,
    scan: Scan,
    /// By whether a voxel has two words.
    gather: [OnceLock<Pipeline>; 2],
    /// By whether distances are floats, there are colours, and confidences: a bit each.
    vertices: [OnceLock<Pipeline>; 8],
    triangles: Pipeline,
    cases: wgpu::Buffer,
}

/// A vertex as `mesh/vertices.wgsl` writes it.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct Vertex {
    position: [f32; 3],
    colour: [u8; 3],
    /// Axis, and from bit 2 on the lowest three bits of where the edge starts along it.
    edge: u8,
    normal: [f32; 3],
    weight: u16,
    /// In sixteenths.
    confidence: u16,
}

/// Blocks that are meshed at a time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Range {
    first: u32,
    count: u32,
}

/// What lies on the device while a mesh is made.
struct Work<'a> {
    map: &'a BlockMap,
    min_weight: u32,
    /// Blocks whose cells count.
    cells_of: u32,
    // For each block of the map; the offsets have one more, the total. Counts until the prefix sum has run.
    edges: wgpu::Buffer,
    vertex_offsets: wgpu::Buffer,
    triangle_offsets: wgpu::Buffer,
    // For each block of a range.
    neighbours: wgpu::Buffer,
    signs: wgpu::Buffer,
    /// A plane each.
    padded: Vec<wgpu::Buffer>,
}

/// The offsets on the host: of each block's vertices and triangles, and the totals.
struct Offsets {
    vertices: Vec<u32>,
    triangles: Vec<u32>,
}

impl Extract {
    /// Compiles the stage.
    pub fn new(device: &Device) -> Self {
        let table = cases::table();
        let cases = device.storage("mesh cases", size_of_val(&table[..]) as u64);
        device.queue.write_buffer(&cases, 0, bytemuck::cast_slice(&table));
        Self {
            device: device.clone(),
            neighbours: Pipeline::plain(device, &mesh::neighbours::PASS),
            signs: Default::default(),
            mark: Pipeline::plain(device, &mesh::mark::PASS),
            count: Pipeline::plain(device, &mesh::count::PASS),
            scan: Scan::new(device),
            gather: Default::default(),
            vertices: Default::default(),
            triangles: Pipeline::plain(device, &mesh::triangles::PASS),
            cases,
        }
    }

    /// Meshes the map: vertices on the zero crossings between voxels, normals from the gradient of the distances, colours
    /// and confidences where the map has such planes, weights and confidences the smaller one of the two voxels. `progress` is told now and then how
    /// many of how many steps are done. The map stays as it is. Waits.
    ///
    /// Blocks of several submaps are meshed each on its own, all in their map's coordinates.
    ///
    /// # Errors
    /// Where the device was lost or ran out of memory, or the mesh has more vertices than 32 bits can number.
    pub fn run(&self, map: &BlockMap, options: &Options, progress: &mut dyn FnMut(u32, u32)) -> Result<Mesh, Error> {
        Ok(self.part(map, options, progress)?.mesh)
    }

    /// The same, with the edge of the lattice that each vertex lies on, for a part of a larger map.
    ///
    /// # Errors
    /// As [`Extract::run`].
    pub fn part(&self, map: &BlockMap, options: &Options, progress: &mut dyn FnMut(u32, u32)) -> Result<Part, Error> {
        let blocks = map.read_record()?.blocks;
        if blocks == 0 {
            return Ok(Part::default());
        }
        let most = self.device.capabilities().max_binding_bytes / PADDED_BYTES;
        let most = u32::try_from(most).unwrap_or(u32::MAX);
        let per_range = options.blocks_per_range.clamp(1, most).min(blocks);
        let work = self.work(map, options, blocks, per_range);
        let counting: Vec<Range> = (0..blocks)
            .step_by(per_range as usize)
            .map(|first| Range { first, count: per_range.min(blocks - first) })
            .collect();
        for range in &counting {
            self.submit_counting(&work, *range);
        }
        let offsets = self.read_offsets(&work, blocks)?;
        // Half of the steps are done: every block is passed twice.
        let steps = blocks.saturating_mul(2);
        progress(blocks, steps);

        let ranges: Vec<Range> = counting.iter().flat_map(|range| offsets.split(*range)).collect();
        let vertex_bytes = ranges.iter().map(|r| offsets.vertex_bytes(*r)).max().unwrap_or(0);
        let triangle_bytes = ranges.iter().map(|r| offsets.triangle_bytes(*r)).max().unwrap_or(0);
        let vertices = self.device.storage("mesh vertices", vertex_bytes);
        let triangles = self.device.storage("mesh triangles", triangle_bytes);
        let vertex_staging = self.device.staging("mesh vertices", vertex_bytes.max(4));
        let triangle_staging = self.device.staging("mesh triangles", triangle_bytes.max(4));
        let mut part = Part::default();
        for range in ranges {
            let (vertex_bytes, triangle_bytes) = (offsets.vertex_bytes(range), offsets.triangle_bytes(range));
            // A block may have either alone: a cell belongs to one block, the vertices on its edges may belong to others.
            if vertex_bytes + triangle_bytes > 0 {
                let mut recorder = Recorder::new(&self.device);
                self.record_output(&mut recorder, &work, range, &offsets, &vertices, &triangles);
                recorder.copy(&vertices, &vertex_staging, vertex_bytes);
                recorder.copy(&triangles, &triangle_staging, triangle_bytes);
                let _untimed = recorder.submit();
                if vertex_bytes > 0 {
                    let vertices: Vec<Vertex> = self.device.read_staging(&vertex_staging, vertex_bytes)?;
                    append_vertices(&mut part, &vertices, map.layout().kind);
                }
                if triangle_bytes > 0 {
                    part.mesh
                        .triangles
                        .extend(self.device.read_staging::<[u32; 3]>(&triangle_staging, triangle_bytes)?);
                }
            }
            progress((blocks + range.first + range.count).min(steps), steps);
        }
        Ok(part)
    }

    fn work<'a>(&self, map: &'a BlockMap, options: &Options, blocks: u32, per_range: u32) -> Work<'a> {
        let (all, range) = (u64::from(blocks), u64::from(per_range));
        let padded = |plane: &Plane| {
            let bytes = PADDED_BYTES * plane.words() as u64;
            self.device.storage("mesh padded voxels", range * bytes)
        };
        Work {
            map,
            min_weight: options.min_weight.max(1),
            cells_of: options.cells_of_first.unwrap_or(u32::MAX),
            edges: self.device.storage("mesh edges", all * EDGE_BYTES),
            vertex_offsets: self.device.storage("mesh vertex offsets", (all + 1) * 4),
            triangle_offsets: self.device.storage("mesh triangle offsets", (all * SLICES + 1) * 4),
            neighbours: self.device.storage("mesh neighbours", range * NEIGHBOUR_BYTES),
            signs: self.device.storage("mesh signs", range * SIGN_BYTES),
            padded: map.planes.iter().map(padded).collect(),
        }
    }

    /// The first sweep: which edges of a range bear vertices, and how many triangles there are.
    fn submit_counting(&self, work: &Work<'_>, range: Range) {
        let mut recorder = Recorder::new(&self.device);
        self.record_signs(&mut recorder, work, range);
        let bindings = mesh::mark::Bindings {
            params: mesh::mark::Params { first: range.first, count: range.count, cells_of: work.cells_of, unused: 0 },
            signs: &work.signs,
            cases: &self.cases,
            edges: &work.edges,
            triangle_counts: &work.triangle_offsets,
            neighbours: &work.neighbours,
        };
        recorder.dispatch(&self.mark, &bindings, Groups::linear(u64::from(range.count) * SLICES, 64));
        let _untimed = recorder.submit();
    }

    /// Finds a range's neighbours and takes down the signs of their voxels.
    fn record_signs(&self, recorder: &mut Recorder, work: &Work<'_>, Range { first, count }: Range) {
        recorder.stage("mesh");
        let bindings = mesh::neighbours::Bindings {
            params: mesh::neighbours::Params { map: work.map.params(), first, count, unused: [0; 2] },
            neighbours: &work.neighbours,
            keys: &work.map.keys,
            hash: &work.map.hash,
        };
        recorder.dispatch(&self.neighbours, &bindings, Groups::linear(u64::from(count) * 27, 64));
        let signs = self.signs[usize::from(work.map.layout().kind.distance == DistanceKind::F32)]
            .get_or_init(|| Pipeline::new(&self.device, &mesh::signs::PASS, work.map.distance_features(), &[]));
        for (voxels, page) in work.map.distances().iter().zip(0..) {
            let bindings = mesh::signs::Bindings {
                params: mesh::signs::Params {
                    count,
                    page,
                    page_shift: work.map.page_shift(),
                    min_weight: work.min_weight,
                },
                neighbours: &work.neighbours,
                voxels,
                signs: &work.signs,
            };
            recorder.dispatch(signs, &bindings, Groups::linear(u64::from(count) * 100, 64));
        }
    }

    /// Turns counts into offsets, and reads them; waits for the first sweep.
    fn read_offsets(&self, work: &Work<'_>, blocks: u32) -> Result<Offsets, Error> {
        let mut recorder = Recorder::new(&self.device);
        recorder.stage("mesh");
        let bindings = mesh::count::Bindings {
            params: mesh::count::Params { blocks },
            edges: &work.edges,
            vertex_counts: &work.vertex_offsets,
        };
        recorder.dispatch(&self.count, &bindings, Groups::linear(blocks.into(), 64));
        // The totals are read with the offsets; where the scan puts them does not matter.
        let (counters, indirect) = (self.device.storage("mesh totals", 4), self.device.storage("mesh indirect", 12));
        let total = Total { counters: &counters, slot: 0, indirect: &indirect, indirect_slot: 0, per_group: 1 };
        self.scan.record(&mut recorder, &work.vertex_offsets, blocks + 1, &total);
        self.scan.record(&mut recorder, &work.triangle_offsets, blocks * SLICES as u32 + 1, &total);
        let _untimed = recorder.submit();
        let all = u64::from(blocks);
        let vertices: Vec<u32> = self.device.read(&work.vertex_offsets, 0, (all + 1) * 4)?;
        let slices: Vec<u32> = self.device.read(&work.triangle_offsets, 0, (all * SLICES + 1) * 4)?;
        let triangles: Vec<u32> = slices.into_iter().step_by(SLICES as usize).collect();
        // A block has few of either, so that sums beyond 32 bits show as a step down.
        if !vertices.is_sorted() || !triangles.is_sorted() {
            return Err(Error::MeshTooLarge { blocks });
        }
        Ok(Offsets { vertices, triangles })
    }

    /// The second sweep: a range's vertices and triangles.
    fn record_output(
        &self,
        recorder: &mut Recorder,
        work: &Work<'_>,
        range: Range,
        offsets: &Offsets,
        vertices: &wgpu::Buffer,
        triangles: &wgpu::Buffer,
    ) {
        let Range { first, count } = range;
        self.record_signs(recorder, work, range);
        for (plane, padded) in work.map.planes.iter().zip(&work.padded) {
            let wide = plane.words() == 2;
            let gather = self.gather[usize::from(wide)].get_or_init(|| {
                let features: &[&str] = if wide { &["f32"] } else { &[] };
                Pipeline::new(&self.device, &mesh::gather::PASS, features, &[])
            });
            for (voxels, page) in plane.pages.iter().zip(0..) {
                let bindings = mesh::gather::Bindings {
                    params: mesh::gather::Params { first, count, page, page_shift: work.map.page_shift() },
                    neighbours: &work.neighbours,
                    vertex_offsets: &work.vertex_offsets,
                    voxels,
                    padded,
                };
                recorder.dispatch(gather, &bindings, Groups::linear(u64::from(count) * 121, 64));
            }
        }
        let kind = work.map.layout().kind;
        let features =
            [("f32", kind.distance == DistanceKind::F32), ("colour", kind.colour), ("confidence", kind.confidence)];
        let index: usize = features.iter().zip(0..).map(|((_, on), bit)| usize::from(*on) << bit).sum();
        let pipeline = self.vertices[index].get_or_init(|| {
            let names: Vec<_> = features.iter().filter(|(_, on)| *on).map(|(name, _)| *name).collect();
            Pipeline::new(&self.device, &mesh::vertices::PASS, &names, &[])
        });
        let bindings = mesh::vertices::Bindings {
            params: mesh::vertices::Params {
                first,
                count,
                first_vertex: offsets.vertices[first as usize],
                voxel_size_m: work.map.layout().voxel_size_m,
            },
            keys: &work.map.keys,
            edges: &work.edges,
            vertex_offsets: &work.vertex_offsets,
            padded: &work.padded[0],
            padded_colours: kind.colour.then(|| &work.padded[1]),
            padded_confidences: work.padded.last().filter(|_| kind.confidence),
            vertices,
        };
        recorder.dispatch(pipeline, &bindings, Groups::linear(u64::from(count) * 6, 64));
        let bindings = mesh::triangles::Bindings {
            params: mesh::triangles::Params {
                first,
                count,
                first_triangle: offsets.triangles[first as usize],
                unused: 0,
            },
            neighbours: &work.neighbours,
            signs: &work.signs,
            cases: &self.cases,
            edges: &work.edges,
            vertex_offsets: &work.vertex_offsets,
            triangle_offsets: &work.triangle_offsets,
            triangles,
        };
        recorder.dispatch(&self.triangles, &bindings, Groups::linear(u64::from(count) * SLICES, 64));
    }
}

impl Offsets {
    fn vertex_bytes(&self, range: Range) -> u64 {
        Self::between(&self.vertices, range) * size_of::<Vertex>() as u64
    }

    fn triangle_bytes(&self, range: Range) -> u64 {
        Self::between(&self.triangles, range) * TRIANGLE_BYTES
    }

    fn between(offsets: &[u32], Range { first, count }: Range) -> u64 {
        (offsets[(first + count) as usize] - offsets[first as usize]).into()
    }

    /// Cuts a range into ranges whose output is small enough; those of one block always are.
    fn split(&self, range: Range) -> Vec<Range> {
        let mut ranges = vec![Range { first: range.first, count: 1 }];
        for block in range.first + 1..range.first + range.count {
            let last = ranges.last_mut().expect("starts with one");
            let longer = Range { first: last.first, count: last.count + 1 };
            if self.vertex_bytes(longer).max(self.triangle_bytes(longer)) <= OUTPUT_BYTES {
                *last = longer;
            } else {
                ranges.push(Range { first: block, count: 1 });
            }
        }
        ranges
    }
}

fn append_vertices(part: &mut Part, vertices: &[Vertex], kind: VoxelKind) {
    let mesh = &mut part.mesh;
    part.edges.extend(vertices.iter().map(|v| v.edge));
    mesh.positions.extend(vertices.iter().map(|v| Vec3::from_array(v.position)));
    mesh.normals.extend(vertices.iter().map(|v| Vec3::from_array(v.normal)));
    mesh.weights.extend(vertices.iter().map(|v| v.weight));
    if kind.colour {
        mesh.colours.extend(vertices.iter().map(|v| v.colour));
    }
    if kind.confidence {
        mesh.confidences.extend(vertices.iter().map(|v| f32::from(v.confidence) / 16.0));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_end_before_their_output_is_too_large() {
        // 1536 vertices are the most that a block can have.
        let blocks = 1000;
        let offsets = Offsets {
            vertices: (0..=blocks).map(|b| b * 1536).collect(),
            triangles: (0..=blocks).map(|b| b * 10).collect(),
        };
        let ranges = offsets.split(Range { first: 100, count: 900 });
        assert_eq!(ranges[0], Range { first: 100, count: 341 });
        assert!(ranges.iter().all(|r| offsets.vertex_bytes(*r) <= OUTPUT_BYTES));
        assert_eq!(ranges.iter().map(|r| r.count).sum::<u32>(), 900);
        assert!(ranges.windows(2).all(|w| w[0].first + w[0].count == w[1].first));
    }
}
