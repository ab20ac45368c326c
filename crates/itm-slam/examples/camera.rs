//! A camera's own loop, which hands its frames over and goes on: what is late is dropped, or the camera waits. A second session looks at
//! the same frames on the same device, and both end from another thread.
//!
//! ```sh
//! cargo run --release -p itm-slam --example camera -- drop     # or wait
//! ```

#![allow(clippy::print_stdout, reason = "this is a program")]

use std::time::{Duration, Instant};

use itm_slam::{CameraLoop, Device, Mode, Poses, Settings, Slam, WhenLate};
use itm_synth::{Path, Sequence, Spec};

/// What a camera takes for a frame.
const PERIOD: Duration = Duration::from_millis(33);

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let when_late = match std::env::args().nth(1).as_deref() {
        None | Some("drop") => WhenLate::Drop,
        Some("wait") => WhenLate::Wait,
        Some(other) => return Err(format!("expected drop or wait, not '{other}'").into()),
    };
    // In place of a camera.
    let camera = Sequence::new(Spec::new(Path::Loop).with_size(160, 120).with_frames(300))?;
    let device = Device::open("auto")?;
    let start = |mode| {
        let settings = Settings { mode, ..Settings::default() };
        Slam::new(&device, &camera.calibration(), &settings, Poses::Tracked)
            .map(|slam| CameraLoop::start(slam, when_late))
    };
    let (voxels, surfels) = (start(Mode::Basic)?, start(Mode::Surfels)?);

    let stoppers = [voxels.stopper(), surfels.stopper()];
    let _stops = std::thread::spawn(move || {
        std::thread::sleep(Duration::from_secs(5));
        stoppers.iter().for_each(itm_slam::Stopper::stop);
    });

    for frame in camera.frames() {
        let due = Instant::now() + PERIOD;
        if !voxels.push(frame.clone()) || !surfels.push(frame) {
            break;
        }
        for result in voxels.results().try_iter() {
            let result = result?;
            if result.index % 30 == 0 {
                println!("frame {}: {:?} at {:?}", result.index, result.status, result.world_from_camera);
            }
        }
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
    }
    for (name, running) in [("voxels", voxels), ("surfels", surfels)] {
        let dropped = running.dropped();
        let slam = running.stop();
        println!("{name}: {} frames have a pose, {dropped} were dropped", slam.trajectory().len());
    }
    Ok(())
}
