//! How long the mesh of a large map takes on this machine: a synthetic terrain of about a million vertices.
//!
//! `cargo run --release -p itm-gpu --example mesh_speed`

#![allow(clippy::print_stdout, reason = "a program")]

use std::time::Instant;

use glam::{IVec3, Vec3};
use itm_core::voxel::{BLOCK_VOXELS, BlockKey, ColourVoxel, DistanceVoxel, VoxelKind};
use itm_gpu::mesh::{Extract, Options};
use itm_gpu::{BlockMap, Device, Error, HostBlock, MapLayout};

const BLOCKS_ACROSS: i32 = 90;
const BAND_VOXELS: f32 = 5.0;

/// Height above rolling hills, in voxels.
fn height(p: Vec3) -> f32 {
    (p.z - 12.0 * (0.05 * p.x).sin() - 9.0 * (0.04 * p.y + 0.01 * p.x).sin()) * 0.8
}

fn main() -> Result<(), Error> {
    let device = Device::open("auto")?;
    let mut blocks = Vec::new();
    for (x, y, z) in (0..BLOCKS_ACROSS * BLOCKS_ACROSS * 10)
        .map(|i| (i % BLOCKS_ACROSS, i / BLOCKS_ACROSS % BLOCKS_ACROSS, i / (BLOCKS_ACROSS * BLOCKS_ACROSS) - 5))
    {
        let position = IVec3::new(x, y, z);
        if height((position * 8).as_vec3() + 3.5).abs() > BAND_VOXELS + 8.0 {
            continue;
        }
        let distance = |i: i32| {
            let at = position * 8 + IVec3::new(i & 7, i >> 3 & 7, i >> 6);
            DistanceVoxel::new(height(at.as_vec3()) / BAND_VOXELS, 9).0
        };
        let colour = ColourVoxel::new([200, 100, 50], 3).0;
        let words: Vec<u32> = (0..BLOCK_VOXELS as i32).map(distance).chain([colour; BLOCK_VOXELS]).collect();
        blocks.push((BlockKey { submap: 0, position }, words));
    }
    for colour in [false, true] {
        let layout =
            MapLayout { voxel_size_m: 0.005, truncation_m: 0.025, kind: VoxelKind { colour, ..VoxelKind::default() } };
        let mut map = BlockMap::new(&device, layout, blocks.len() as u32)?;
        let planes = layout.kind.words();
        let host: Vec<_> =
            blocks.iter().map(|(key, words)| HostBlock { key: *key, words: &words[..planes * BLOCK_VOXELS] }).collect();
        let start = Instant::now();
        map.insert_blocks(&host)?;
        println!("{} blocks uploaded in {:.0?}", host.len(), start.elapsed());
        let extract = Extract::new(&device);
        for _ in 0..3 {
            let start = Instant::now();
            let mut counted = start;
            let mesh = extract.run(&map, &Options::default(), &mut |done, of| {
                if 2 * done == of {
                    counted = Instant::now();
                }
            })?;
            println!(
                "{} vertices and {} triangles{} in {:.0?}, of which {:.0?} to count them",
                mesh.positions.len(),
                mesh.triangles.len(),
                if colour { " with colour" } else { "" },
                start.elapsed(),
                counted - start,
            );
        }
    }
    Ok(())
}
