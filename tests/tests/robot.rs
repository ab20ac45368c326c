//! What robots ask of a session while it runs, with all blocks on the device and with most of them elsewhere.

use std::collections::{BTreeMap, BTreeSet};

use glam::{DVec2, Vec3};
use itm_slam::voxel::BlockKey;
use itm_slam::{BlockSource as _, Device, Error, Mesh, Poses, SavedMap, Settings, Slam, with_neighbours};
use itm_synth::{Path, Sequence};
use itm_tests::{device, sequence};

const VOXEL_M: f32 = 0.02;

/// Small voxels' worth of map for small images.
fn settings(device_budget_mib: f64) -> Settings {
    let mut settings = Settings::default();
    settings.map.voxel_size_m = VOXEL_M;
    settings.map.truncation_m = 4.0 * VOXEL_M;
    settings.map.initial_blocks = 256;
    settings.map.device_budget_mib = device_budget_mib;
    settings.map.track_changes = true;
    settings
}

fn start(device: &Device, sequence: &Sequence, settings: &Settings) -> Slam {
    Slam::new(device, &sequence.calibration(), settings, Poses::Given).expect("a small map fits")
}

fn process(slam: &mut Slam, sequence: &Sequence, frames: std::ops::Range<usize>) {
    for frame in sequence.frames().skip(frames.start).take(frames.len()) {
        let result = slam.process(&frame).expect("a result");
        let mut notices = result.report.into_iter().flat_map(|report| report.notices);
        assert!(notices.next().is_none(), "every block finds room");
    }
}

fn packed(keys: &[BlockKey]) -> BTreeSet<[u32; 2]> {
    keys.iter().map(|key| key.pack()).collect()
}

/// Points within three voxels of the surfaces that some frames saw.
fn near_surfaces(sequence: &Sequence, frames: &[u32]) -> Vec<Vec3> {
    let camera = sequence.calibration().depth;
    let mut points = Vec::new();
    for &index in frames {
        let pose = sequence.world_from_camera(index);
        let frame = sequence.frame(index);
        let itm_slam::DepthImage::Metres(depth) = &frame.depth else { continue };
        for (x, y) in
            (4..camera.height - 4).step_by(3).flat_map(|y| (4..camera.width - 4).step_by(3).map(move |x| (x, y)))
        {
            let z = f64::from(depth[(x, y)]);
            if (0.5..3.5).contains(&z) {
                let off = f64::from(VOXEL_M) * (f64::from((x * 7 + y * 11) % 60) / 10.0 - 3.0);
                let seen = camera.unproject(DVec2::new(x.into(), y.into()), z + off);
                points.push(pose.transform_point(seen).as_vec3());
            }
        }
    }
    points
}

fn quantile(mut values: Vec<f32>, share: f32) -> f32 {
    values.sort_by(f32::total_cmp);
    values[((values.len() - 1) as f32 * share) as usize]
}

#[test]
fn distances_are_the_same_wherever_blocks_lie_and_asking_changes_nothing() {
    let Some(device) = device() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let sequence = sequence(Path::Loop, (160, 120), 60);
    let mut whole = start(&device, &sequence, &settings(0.0));
    let mut small = start(&device, &sequence, &settings(3.0));
    let mut unasked = start(&device, &sequence, &settings(3.0));
    let mut on_host = 0;
    for end in [10, 25, 40, 55, 60] {
        let begin = small.frames() as usize;
        for slam in [&mut whole, &mut small, &mut unasked] {
            process(slam, &sequence, begin..end);
        }
        on_host = on_host.max(small.stored_blocks());
        let frames: Vec<u32> = (0..end as u32).step_by(5).collect();
        let points = near_surfaces(&sequence, &frames);
        let expected = whole.samples(&points).expect("answers");
        let found = small.samples(&points).expect("answers");
        let known = expected.iter().flatten().count();
        assert!(known > points.len() / 2 && known > 500, "{known} of {}", points.len());
        // What a block's two parts saw is fused in another order, and now and then a voxel's weight is at its limit.
        let both: Vec<f32> = expected
            .iter()
            .zip(&found)
            .filter_map(|(a, b)| Some((a.as_ref()?.distance_m - b.as_ref()?.distance_m).abs()))
            .collect();
        assert!(both.len() * 1000 > known * 995, "{} of {known} are known after {end} frames", both.len());
        assert!(quantile(both.clone(), 0.99) < 0.05 * VOXEL_M, "{:?}", quantile(both, 0.99));
        // Against the scene itself.
        let off = points.iter().zip(&found).filter_map(|(point, sample)| {
            let truth = sequence.scene().distance(*point);
            (truth.abs() < 2.0 * VOXEL_M).then_some(((*sample)?.distance_m - truth).abs())
        });
        let median = quantile(off.collect(), 0.5);
        assert!(median < 0.3 * VOXEL_M, "{median}");
        let keys = small.changed_since(0).expect("changes are tracked");
        small.mesh_of(&keys[..20]).expect("a mesh");
    }
    assert!(on_host > 100, "{on_host} blocks are stored");
    let bytes = |slam: &mut Slam, name: &str| {
        let path = folder.path().join(name);
        slam.save(&path).expect("saved");
        std::fs::read(path).expect("read")
    };
    assert!(bytes(&mut small, "a.itm") == bytes(&mut unasked, "b.itm"), "asking has changed the session");
    let odd = [Vec3::NAN, Vec3::splat(1e9), Vec3::splat(50.0)];
    assert_eq!(small.distances(&odd).expect("answers"), [None; 3]);
}

#[test]
fn changes_are_known_wherever_blocks_lie_and_survive_a_save() {
    let Some(device) = device() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let sequence = sequence(Path::Loop, (160, 120), 60);
    let mut changes = Vec::new();
    for budget in [0.0, 3.0] {
        let mut slam = start(&device, &sequence, &settings(budget));
        assert_eq!((slam.frames(), slam.changed_since(0).expect("tracked").len()), (0, 0));
        process(&mut slam, &sequence, 0..33);
        assert_eq!(slam.frames(), 33);
        assert!(slam.changed_since(33).expect("tracked").is_empty());
        let path = folder.path().join("half.itm");
        slam.save(&path).expect("saved");
        let mut resumed = Slam::resume(&device, &path).expect("resumed");
        for since in [0, 10, 25, 32] {
            assert_eq!(resumed.changed_since(since).expect("tracked"), slam.changed_since(since).expect("tracked"));
        }
        process(&mut slam, &sequence, 33..50);
        process(&mut resumed, &sequence, 33..50);
        let found: Vec<_> = [0, 20, 40, 49].map(|since| slam.changed_since(since).expect("tracked")).to_vec();
        for (since, found) in [0, 20, 40, 49].into_iter().zip(&found) {
            assert_eq!(&resumed.changed_since(since).expect("tracked"), found);
        }
        assert!(
            found.windows(2).all(|pair| packed(&pair[1]).is_subset(&packed(&pair[0])) && pair[1].len() < pair[0].len())
        );
        assert!(!found[3].is_empty());
        let path = folder.path().join("all.itm");
        slam.save(&path).expect("saved");
        let map = SavedMap::open(&path, u64::MAX, &mut |_, _| ()).expect("a map");
        assert_eq!(packed(&found[0]), packed(&map.keys()), "every block was changed by some frame");
        assert_eq!(slam.stored_blocks() > 0, budget > 0.0);
        changes.push(found);
    }
    // Where blocks lie does not matter, but for those that were merged when they came back.
    for (whole, small) in changes[0].iter().zip(&changes[1]) {
        let (whole, small) = (packed(whole), packed(small));
        let missing = whole.difference(&small).count();
        assert!(missing * 100 <= whole.len(), "{missing} of {} are missing", whole.len());
    }
    let mut untracked = settings(0.0);
    untracked.map.track_changes = false;
    let refused = start(&device, &sequence, &untracked).changed_since(0);
    assert!(matches!(refused, Err(Error::ChangesNotTracked)));
}

type Corners = [[u32; 3]; 3];

/// The triangles' corners, to the bit, each starting with its smallest.
fn triangles(mesh: &Mesh) -> Vec<Corners> {
    let turned = |t: &[u32; 3]| {
        let mut corners = t.map(|v| mesh.positions[v as usize].to_array().map(f32::to_bits));
        let smallest = (0..3).min_by_key(|&i| corners[i]).unwrap_or(0);
        corners.rotate_left(smallest);
        corners
    };
    let mut all: Vec<_> = mesh.triangles.iter().map(turned).collect();
    all.sort_unstable();
    all
}

#[test]
fn a_mesh_that_follows_the_changes_is_the_mesh_of_the_whole() {
    let Some(device) = device() else { return };
    let sequence = sequence(Path::Loop, (80, 60), 40);
    let mut settings = settings(0.0);
    settings.map.voxel_size_m = 0.05;
    settings.map.truncation_m = 0.2;
    let mut slam = start(&device, &sequence, &settings);
    let mut parts: BTreeMap<[u32; 2], Vec<Corners>> = BTreeMap::new();
    let mut seen = 0;
    for end in [10, 20, 30] {
        process(&mut slam, &sequence, seen as usize..end);
        let changed = with_neighbours(&slam.changed_since(seen).expect("tracked"));
        seen = slam.frames();
        let mut together = Vec::new();
        for key in &changed {
            let part = triangles(&slam.mesh_of(&[*key, *key]).expect("a mesh"));
            together.extend_from_slice(&part);
            parts.insert(key.pack(), part);
        }
        together.sort_unstable();
        let mesh = slam.mesh_of(&changed).expect("a mesh");
        assert!(together == triangles(&mesh), "one by one as all at once");
        assert!(mesh.positions.len() < 3 * mesh.triangles.len() / 2, "vertices are shared");
        let there = packed(&slam.blocks().expect("keys"));
        parts.retain(|key, _| there.contains(key));
        let whole = slam.mesh(&mut |_, _| ()).expect("a mesh");
        let mut following = parts.values().flatten().copied().collect::<Vec<_>>();
        following.sort_unstable();
        assert!(following == triangles(&whole), "{} triangles, not {}", following.len(), whole.triangles.len());
        assert!(following.len() > 500);
    }
}
