//! How long a saved map takes to write, open, mesh in chunks and look at: a bumpy floor of a side in metres.
//!
//! `cargo run --release --example saved_speed -- 12`

#![allow(clippy::print_stdout, reason = "this is a program")]

use std::time::Instant;

use glam::{DQuat, DVec3, IVec3, Vec3};
use itm_io::map_file::{MapHeader, MapWriter, tag};
use itm_slam::voxel::{BlockKey, ColourVoxel, DistanceVoxel, VoxelKind};
use itm_slam::{
    BlockSource as _, Calibration, DepthConversion, Device, Intrinsics, MapViews, MeshOptions, SavedMap, Scale, Se3,
    Settings, Shading,
};

const VOXEL_M: f32 = 0.005;
const BAND_VOXELS: f32 = 4.0;

/// Height over the floor in voxels, downwards positive as the camera's y.
fn height(p: Vec3) -> f32 {
    let wave = 6.0 * (p.x * 0.05).sin() * (p.z * 0.04).cos() + 1.5 * (p.x * 0.31 + p.z * 0.27).sin();
    -(p.y + wave)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let side_m: f32 = std::env::args().nth(1).map_or(Ok(6.0), |side| side.parse())?;
    let side = (side_m / (8.0 * VOXEL_M)) as i32;
    let settings = Settings::default();
    let kind = VoxelKind { colour: true, ..VoxelKind::default() };
    let camera = Intrinsics::new(640, 480, 525.0, 525.0, 319.5, 239.5);
    let header = MapHeader::new(&settings, Calibration::registered(camera, DepthConversion::MILLIMETRES), kind);
    let folder = std::env::temp_dir();
    let path = folder.join(format!("saved_speed_{}.itm", std::process::id()));
    let start = Instant::now();
    let mut writer = MapWriter::create(&path, &header)?;
    writer.blocks::<itm_io::Error>(tag::BLOCKS, |sink| {
        for (x, y, z) in (0..side).flat_map(|z| (-3..3).flat_map(move |y| (0..side).map(move |x| (x, y, z)))) {
            let position = IVec3::new(x, y, z);
            if height((position * 8).as_vec3() + 3.5).abs() > BAND_VOXELS + 9.0 {
                continue;
            }
            let at = |i: i32| (position * 8 + IVec3::new(i & 7, i >> 3 & 7, i >> 6)).as_vec3();
            // Noise in the lowest bits, as measurements leave it.
            let noise = |i: i32| ((i.wrapping_mul(40_503) ^ x ^ (z << 7)) & 0xff) as f32 * 2e-5;
            let distances = (0..512).map(|i| DistanceVoxel::new(height(at(i)) / BAND_VOXELS + noise(i), 9).0);
            let colour = |i: i32| ColourVoxel::new([(x * 5) as u8, (z * 3) as u8, (i >> 2) as u8], 9).0;
            let words: Vec<u32> = distances.chain((0..512).map(colour)).collect();
            sink.block(BlockKey { submap: 0, position }, &words)?;
        }
        Ok(())
    })?;
    writer.finish()?;
    let mib = |bytes: u64| bytes as f64 / f64::from(1 << 20);
    println!("written in {:.2?}: {:.1} MiB", start.elapsed(), mib(std::fs::metadata(&path)?.len()));
    let device = Device::open("auto")?;
    for budget in [1_u64 << 32, 16 << 20] {
        let start = Instant::now();
        let mut map = SavedMap::open(&path, budget, &mut |_, _| ())?;
        let voxels = mib(map.blocks() as u64 * kind.block_bytes());
        println!(
            "{} blocks, {voxels:.0} MiB, opened in {:.2?} with {:.0} MiB",
            map.blocks(),
            start.elapsed(),
            mib(budget)
        );
        for max_blocks in [u32::MAX, 16_384, 2048] {
            let start = Instant::now();
            let mesh = map.mesh(&device, &MeshOptions { max_blocks, ..MeshOptions::default() }, &mut |_, _| ())?;
            let seconds = start.elapsed().as_secs_f64();
            let triangles = mesh.triangles.len();
            println!(
                "{triangles} triangles in {seconds:.2} s, {:.2} million a second, chunks of {max_blocks}",
                triangles as f64 / seconds * 1e-6
            );
        }
        let mut views = MapViews::new(&device, map.layout(), 0, 65_536)?;
        for i in 0..4 {
            let eye = DVec3::new(1.0 + 0.1 * f64::from(i), -1.2, 0.2);
            let pose = Se3::new(DQuat::from_rotation_x(-0.6), eye);
            let start = Instant::now();
            views.look(&mut map, &camera, &pose, 4.0)?;
            let picture = views.picture(Shading::Grey, &Scale::default())?;
            let share = picture.data().iter().filter(|p| p[3] > 0).count() as f64 / camera.pixels() as f64;
            println!(
                "a view of {} blocks in {:.0?}, {:.0} % of it surface",
                views.blocks(),
                start.elapsed(),
                100.0 * share
            );
        }
    }
    std::fs::remove_file(&path)?;
    Ok(())
}
