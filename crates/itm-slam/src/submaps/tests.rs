use itm_core::{Mode, Settings};
use itm_gpu::Device;
use itm_synth::{Path, Sequence, Spec};

use super::*;
use crate::{FrameStatus, Poses};

#[test]
fn what_is_on_trial_is_known_by_both_its_submaps() {
    // Mostly the camera comes back to an earlier submap.
    for (from, submap) in [(8, 0), (0, 8)] {
        let life = Life { failed: 0, trial: Some(Trial::begin(from, submap)) };
        assert_eq!(life.check(submap, 9), Ok(()));
        assert!(life.check(3, 9).is_err());
        assert!(life.check(submap, 8).is_err(), "there is no submap 8");
    }
    assert_eq!(Life::default().check(3, 9), Ok(()));
}

#[test]
fn a_camera_that_is_lost_in_the_primary_goes_on_in_another_active_submap() {
    if std::env::var_os("ITM_SKIP_GPU_TESTS").is_some() {
        return;
    }
    let device = Device::open("auto").expect("GPU tests need an adapter; a software driver will do");
    let sequence = Sequence::new(Spec::new(Path::Loop).with_size(160, 120).with_frames(60)).expect("it is valid");
    let mut settings = Settings { mode: Mode::LoopClosure, ..Settings::default() };
    settings.map.voxel_size_m = 0.02;
    settings.map.truncation_m = 0.08;
    settings.submaps.new_below = 0.5;
    let mut slam = Slam::new(&device, &sequence.calibration(), &settings, Poses::Tracked).expect("a small map fits");
    let mut frames = sequence.frames();
    let mut last = Se3::IDENTITY;
    while slam.beside.is_empty() {
        last = slam
            .process(&frames.next().expect("a submap begins"))
            .expect("a result")
            .world_from_camera
            .expect("a pose");
    }
    let (old, new) = (slam.beside[0].local.submap, slam.primary.submap);
    // Not to begin another one in the same frame.
    slam.settings.submaps.new_below = 0.0;
    // The new one's model is lost sight of: as if it had been seen from two metres behind and the other way round.
    let behind = Se3::exp([0.0, 0.0, -2.0, 0.0, 0.0, 0.0]) * Se3::exp([0.0, 0.0, 0.0, 0.0, 3.0, 0.0]);
    slam.primary.submap_from_model = Some(behind);
    slam.primary.motion.return_to(behind);
    let result = slam.process(&frames.next().expect("a frame")).expect("a result");
    assert_eq!(result.status, FrameStatus::Tracked);
    assert_eq!((result.submap, slam.primary.submap), (old, old));
    assert!(result.happenings.contains(&Happening::Primary { submap: old, from: new }), "{:?}", result.happenings);
    assert!(result.happenings.contains(&Happening::Passive { submap: new }), "{:?}", result.happenings);
    let moved_m = last.translation.distance(result.world_from_camera.expect("a pose").translation);
    assert!(moved_m < 0.05, "{moved_m} m from one frame to the next");
    assert!(slam.submaps().iter().filter(|submap| submap.state == SubmapState::Primary).count() == 1);
}
