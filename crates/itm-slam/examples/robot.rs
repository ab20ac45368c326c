//! What a robot asks of a map while it is being made: every ten frames a mesh of what has changed, and the distances along
//! the way that it plans. Runs on a synthetic sequence, with a device memory that is too small for all of the map.
//!
//! ```sh
//! cargo run --release -p itm-slam --example robot -- 60      # frames
//! ```

#![allow(clippy::print_stdout, reason = "this is a program")]

use std::time::Instant;

use glam::{DVec3, Vec3};
use itm_slam::{Device, Poses, Se3, Settings, Slam, with_neighbours};
use itm_synth::{Path, Sequence, Spec};

/// The robot is a ball of this radius, in metres.
const RADIUS_M: f32 = 0.1;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let frames = std::env::args().nth(1).map_or(Ok(60), |frames| frames.parse())?;
    let sequence = Sequence::new(Spec::new(Path::Loop).with_size(160, 120).with_frames(frames))?;
    let mut settings = Settings::default();
    settings.map.voxel_size_m = 0.02;
    // Distances saturate here, so the band is wider than the robot.
    settings.map.truncation_m = 0.12;
    settings.map.track_changes = true;
    settings.map.device_budget_mib = 4.0;
    let mut slam = Slam::new(&Device::open("auto")?, &sequence.calibration(), &settings, Poses::Given)?;
    let mut seen = 0;
    for frame in sequence.frames() {
        slam.process(&frame)?;
        if !slam.frames().is_multiple_of(10) {
            continue;
        }
        let start = Instant::now();
        let changed = slam.changed_since(seen)?;
        seen = slam.frames();
        let mesh = slam.mesh_of(&with_neighbours(&changed))?;
        let meshed = start.elapsed();
        let start = Instant::now();
        let path = plan(&sequence.world_from_camera(frame.index as u32));
        let samples = slam.samples(&path)?;
        let asked = start.elapsed();
        // The map has no blocks in space that is far from all surfaces, seen or not: that it is free is for depth to say.
        let near = |distance_m: f32| distance_m < RADIUS_M;
        let clear = samples.iter().take_while(|sample| !sample.is_some_and(|s| near(s.distance_m))).count();
        let known = samples.iter().flatten();
        let nearest = known.min_by(|a, b| a.distance_m.total_cmp(&b.distance_m));
        println!(
            "frame {:3}: {} blocks changed, {} triangles in {meshed:.0?}; {clear} of {} points before a surface ({asked:.0?}); {}",
            frame.index,
            changed.len(),
            mesh.triangles.len(),
            path.len(),
            nearest.map_or("nothing is known of them".to_string(), |sample| format!(
                "nearest surface {:.3} m, away from it {:.2}",
                sample.distance_m, sample.gradient
            )),
        );
    }
    println!("{} blocks lie in the host's store", slam.stored_blocks());
    Ok(())
}

/// Where the robot means to go: two metres ahead of the camera, in steps of a centimetre.
fn plan(world_from_camera: &Se3) -> Vec<Vec3> {
    let ahead = |step: u32| DVec3::new(0.0, 0.0, 0.3 + 0.01 * f64::from(step));
    (0..200).map(|step| world_from_camera.transform_point(ahead(step)).as_vec3()).collect()
}
