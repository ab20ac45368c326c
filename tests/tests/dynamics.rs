//! Objects that move, in maps of surfels, in whole runs.

use itm_slam::evaluation::{DEFAULT_TOLERANCE_NS, evaluate};
use itm_slam::surfel::Surfel;
use itm_slam::{Device, Mode, Poses, Settings, Slam};
use itm_synth::{DepthNoise, Path, Sequence, Spec};
use itm_tests::{device, sequence};

/// Frames of [`Path::Carried`] at which the box is lifted, and is wholly out of its place (see `the_box_…`).
const LIFTED: u32 = 72;
const GONE: u32 = 94;

fn settings(enabled: bool) -> Settings {
    let mut settings = Settings { mode: Mode::Surfels, ..Settings::default() };
    settings.tracker.extended.levels = "bbb".into();
    settings.surfels.dynamics.enabled = enabled;
    // Cells of as many pixels as a quarter of a larger image's.
    settings.surfels.dynamics.cell_px = 2;
    settings
}

fn carried(noise: Option<DepthNoise>) -> Sequence {
    let spec = Spec::new(Path::Carried).with_size(160, 120).with_frames(200);
    Sequence::new(noise.map_or(spec, |noise| spec.with_noise(noise, 3))).expect("a valid specification")
}

fn start(device: &Device, sequence: &Sequence, settings: &Settings) -> Slam {
    Slam::new(device, &sequence.calibration(), settings, Poses::Tracked).expect("a small map fits")
}

fn process(slam: &mut Slam, sequence: &Sequence, frames: std::ops::Range<u32>) {
    for index in frames {
        slam.process(&sequence.frame(index)).expect("a result");
    }
}

fn ate_m(slam: &Slam, truth: &Sequence) -> f64 {
    let evaluation = evaluate(slam.trajectory(), &truth.trajectory(), DEFAULT_TOLERANCE_NS);
    evaluation.expect("poses to compare").ate.rmse
}

/// Surfels within the box as it stood at first, or up to 3 cm beside it, that lie on nothing that stays; and how many of them are stable.
fn ghost(slam: &Slam, sequence: &Sequence) -> (usize, usize) {
    let spec = sequence.spec();
    let box_from_world = spec.path.world_from_carried(0.0, spec.duration_s).expect("a box").inverse();
    // The map's frame is the first camera's.
    let world_from_map = sequence.world_from_camera(0);
    let is_left = |surfel: &&Surfel| {
        let place = world_from_map.transform_point(surfel.position.as_dvec3());
        let p = box_from_world.transform_point(place);
        let is_within = p.x.abs() < 0.21 && p.z.abs() < 0.19 && (-0.37..0.0).contains(&p.y);
        is_within && sequence.scene().distance(place.as_vec3()).abs() > 0.03
    };
    let all = slam.all_surfels().expect("the device answers");
    let left: Vec<&Surfel> = all.iter().filter(is_left).collect();
    (left.len(), left.iter().filter(|surfel| surfel.confidence >= slam.settings().surfels.stable).count())
}

/// Stable surfels on what stays.
fn of_scene(slam: &Slam, sequence: &Sequence) -> usize {
    let world_from_map = sequence.world_from_camera(0);
    let off = |surfel: &Surfel| {
        let place = world_from_map.transform_point(surfel.position.as_dvec3());
        sequence.scene().distance(place.as_vec3()).abs()
    };
    slam.surfels().expect("the device answers").iter().filter(|surfel| off(surfel) < 0.03).count()
}

#[test]
fn the_box_leaves_no_ghost_within_thirty_frames() {
    let Some(device) = device() else { return };
    for noise in [None, Some(DepthNoise::KINECT)] {
        let sequence = carried(noise);
        // What is there of the box when it is lifted, when it has left its place, and thirty frames later.
        let [without, with] = [false, true].map(|enabled| {
            let mut slam = start(&device, &sequence, &settings(enabled));
            let mut at = 0;
            let ghosts = [LIFTED, GONE, GONE + 30].map(|until| {
                process(&mut slam, &sequence, at..until);
                at = until;
                ghost(&slam, &sequence)
            });
            let (stable, ate) = (of_scene(&slam, &sequence), ate_m(&slam, &sequence));
            println!("{enabled}: (all, stable) {ghosts:?}, {stable} stable surfels, ATE {:.2} mm", ate * 1e3);
            (ghosts, stable, ate)
        });
        let ([whole, ..], ..) = without;
        assert!(whole.1 > 400, "the box is in the map: {whole:?}");
        assert_eq!(with.0[0], whole, "while nothing moves nothing changes");
        // Without, what is exported has a whole box where none is any more, until what is behind is known as well.
        assert!(without.0[1].1 > whole.1 * 8 / 10, "{without:?}");
        assert!(with.0[1].1 < whole.1 / 5, "{with:?}");
        assert_eq!(with.0[2], (0, 0), "a ghost is left");
        assert!(with.1 as f64 > 0.99 * without.1 as f64, "{} of {} surfels are left", with.1, without.1);
        assert!(with.2 < 2e-3 && with.2 < without.2 + 5e-4, "{} and {} m", with.2, without.2);
    }
}

#[test]
fn scenes_that_stay_keep_their_surfels() {
    let Some(device) = device() else { return };
    for (path, frames) in [(Path::Loop, 120), (Path::Fast, 60)] {
        let spec = (*sequence(path, (160, 120), frames).spec()).with_noise(DepthNoise::KINECT, 3);
        let sequence = Sequence::new(spec).expect("a valid specification");
        let [without, with] = [false, true].map(|enabled| {
            let mut slam = start(&device, &sequence, &settings(enabled));
            process(&mut slam, &sequence, 0..frames);
            (slam.surfels().expect("the device answers").len(), ate_m(&slam, &sequence))
        });
        println!("{path}: stable surfels and ATE in m {without:?}, with dynamics {with:?}");
        assert!(with.0 as f64 > 0.99 * without.0 as f64, "{with:?} and {without:?}");
        assert!(with.1 < without.1 + 1e-3, "{with:?} and {without:?}");
    }
}

#[test]
fn runs_with_dynamics_repeat_and_go_on_after_a_save_to_the_same_bytes() {
    let Some(device) = device() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let bytes = |name: &str| std::fs::read(at(name)).expect("it was written");
    // From where on the box is about to be lifted.
    let (sequence, first) = (carried(Some(DepthNoise::KINECT)), 40);
    for name in ["whole.itm", "again.itm"] {
        let mut slam = start(&device, &sequence, &settings(true));
        process(&mut slam, &sequence, first..first + 70);
        slam.save(&at(name)).expect("saved");
    }
    assert!(bytes("whole.itm") == bytes("again.itm"), "another map");
    let mut slam = start(&device, &sequence, &settings(true));
    process(&mut slam, &sequence, first..first + 47);
    slam.save(&at("half.itm")).expect("saved");
    let mut second = Slam::resume(&device, &at("half.itm")).expect("resumed");
    process(&mut second, &sequence, first + 47..first + 70);
    second.save(&at("second.itm")).expect("saved");
    assert!(bytes("second.itm") == bytes("whole.itm"), "another map after a save");
}
