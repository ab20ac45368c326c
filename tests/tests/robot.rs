//! What robots ask of a session while it runs, with all blocks on the device and with most of them elsewhere, in one map and in
//! one of submaps.

use std::collections::{BTreeMap, BTreeSet};

use glam::{DVec2, Vec3};
use itm_slam::voxel::BlockKey;
use itm_slam::{BlockSource as _, Device, Error, Mesh, Mode, Poses, SavedMap, Se3, Settings, Slam, with_neighbours};
use itm_synth::{Path, Sequence};
use itm_tests::{device, sequence};

const VOXEL_M: f32 = 0.02;

/// The kinds of maps, with where their poses come from: given ones are those of one map, whatever the mode.
const KINDS: [(Mode, Poses); 2] = [(Mode::Basic, Poses::Given), (Mode::LoopClosure, Poses::Tracked)];

/// Small voxels' worth of map for small images, and submaps that begin after some frames.
fn settings(mode: Mode, device_budget_mib: f64) -> Settings {
    let mut settings = Settings { mode, ..Settings::default() };
    (settings.submaps.new_below, settings.submaps.max_active) = (0.5, 2);
    settings.map.voxel_size_m = VOXEL_M;
    settings.map.truncation_m = 4.0 * VOXEL_M;
    settings.map.initial_blocks = 256;
    settings.map.device_budget_mib = device_budget_mib;
    settings.map.track_changes = true;
    settings
}

fn start(device: &Device, sequence: &Sequence, settings: &Settings, poses: Poses) -> Slam {
    Slam::new(device, &sequence.calibration(), settings, poses).expect("a small map fits")
}

/// Whether a session has come to several submaps, where it should.
fn check_submaps(slam: &Slam, poses: Poses) {
    let submaps = slam.submaps().len();
    assert!(if poses == Poses::Tracked { submaps >= 2 } else { submaps == 0 }, "{submaps} submaps");
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

/// Where the scene lies in the world: tracking begins at the first camera.
fn world_from_scene(sequence: &Sequence, poses: Poses) -> Se3 {
    if poses == Poses::Given { Se3::IDENTITY } else { sequence.world_from_camera(0).inverse() }
}

/// Points of the scene within three voxels of the surfaces that some frames saw.
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
    // Several submaps have several views to keep.
    for ((mode, poses), budget) in KINDS.into_iter().zip([3.0, 6.0]) {
        let mut whole = start(&device, &sequence, &settings(mode, 0.0), poses);
        let mut small = start(&device, &sequence, &settings(mode, budget), poses);
        let mut unasked = start(&device, &sequence, &settings(mode, budget), poses);
        let world_from_scene = world_from_scene(&sequence, poses);
        let mut on_host = 0;
        for end in [10, 25, 40, 55, 60] {
            let begin = small.frames() as usize;
            for slam in [&mut whole, &mut small, &mut unasked] {
                process(slam, &sequence, begin..end);
            }
            on_host = on_host.max(small.stored_blocks());
            let frames: Vec<u32> = (0..end as u32).step_by(5).collect();
            let of_scene = near_surfaces(&sequence, &frames);
            let points: Vec<Vec3> =
                of_scene.iter().map(|point| world_from_scene.transform_point(point.as_dvec3()).as_vec3()).collect();
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
            let off = of_scene.iter().zip(&found).filter_map(|(point, sample)| {
                let truth = sequence.scene().distance(*point);
                (truth.abs() < 2.0 * VOXEL_M).then_some(((*sample)?.distance_m - truth).abs())
            });
            let median = quantile(off.collect(), 0.5);
            assert!(median < 0.3 * VOXEL_M, "{median}");
            let keys = small.changed_since(0).expect("changes are tracked");
            small.mesh_of(&keys[..20]).expect("a mesh");
        }
        check_submaps(&small, poses);
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
}

#[test]
fn changes_are_known_wherever_blocks_lie_and_survive_a_save() {
    let Some(device) = device() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let sequence = sequence(Path::Loop, (160, 120), 60);
    for ((mode, poses), small) in KINDS.into_iter().zip([3.0, 6.0]) {
        let mut changes = Vec::new();
        for budget in [0.0, small] {
            let mut slam = start(&device, &sequence, &settings(mode, budget), poses);
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
            check_submaps(&slam, poses);
            let found: Vec<_> = [0, 20, 40, 49].map(|since| slam.changed_since(since).expect("tracked")).to_vec();
            for (since, found) in [0, 20, 40, 49].into_iter().zip(&found) {
                assert_eq!(&resumed.changed_since(since).expect("tracked"), found);
            }
            let fewer =
                |pair: &[Vec<BlockKey>]| packed(&pair[1]).is_subset(&packed(&pair[0])) && pair[1].len() < pair[0].len();
            assert!(found.windows(2).all(fewer));
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
        let mut untracked = settings(mode, 0.0);
        untracked.map.track_changes = false;
        let refused = start(&device, &sequence, &untracked, poses).changed_since(0);
        assert!(matches!(refused, Err(Error::ChangesNotTracked)));
    }
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

/// Of submaps each one's mesh is followed in its own frame; the mesh of the whole map is of all of them as one.
#[test]
fn a_mesh_that_follows_the_changes_is_the_mesh_of_the_whole() {
    let Some(device) = device() else { return };
    for (mode, poses) in KINDS {
        // Submaps need images that can be tracked, and further to go.
        let (size, frames) = if poses == Poses::Given { ((80, 60), [10, 20, 30]) } else { ((160, 120), [20, 40, 50]) };
        let sequence = sequence(Path::Loop, size, 60);
        let mut settings = settings(mode, 0.0);
        settings.map.voxel_size_m = 0.05;
        settings.map.truncation_m = 0.2;
        let mut slam = start(&device, &sequence, &settings, poses);
        let mut parts: BTreeMap<[u32; 2], Vec<Corners>> = BTreeMap::new();
        let mut seen = 0;
        for end in frames {
            process(&mut slam, &sequence, seen as usize..end);
            let changed = with_neighbours(&slam.changed_since(seen).expect("tracked"));
            seen = slam.frames();
            let there = slam.blocks().expect("keys");
            let submaps: BTreeSet<u16> = there.iter().map(|key| key.submap).collect();
            for submap in &submaps {
                let of_submap: Vec<BlockKey> = changed.iter().filter(|key| key.submap == *submap).copied().collect();
                let mut together = Vec::new();
                for key in &of_submap {
                    let part = triangles(&slam.mesh_of(&[*key, *key]).expect("a mesh"));
                    together.extend_from_slice(&part);
                    parts.insert(key.pack(), part);
                }
                together.sort_unstable();
                let mesh = slam.mesh_of(&of_submap).expect("a mesh");
                assert!(together == triangles(&mesh), "one by one as all at once");
                assert!(of_submap.len() < 10 || mesh.positions.len() < 3 * mesh.triangles.len() / 2, "shared vertices");
            }
            let there_packed = packed(&there);
            parts.retain(|key, _| there_packed.contains(key));
            for submap in &submaps {
                let whole = match poses {
                    Poses::Given => slam.mesh(&mut |_, _| ()).expect("a mesh"),
                    Poses::Tracked => {
                        let own: Vec<BlockKey> = there.iter().filter(|key| key.submap == *submap).copied().collect();
                        slam.mesh_of(&own).expect("a mesh")
                    }
                };
                let own = parts.iter().filter(|(key, _)| BlockKey::unpack(**key).submap == *submap);
                let mut following: Vec<Corners> = own.flat_map(|(_, part)| part).copied().collect();
                following.sort_unstable();
                assert!(following == triangles(&whole), "{} triangles, not {}", following.len(), whole.triangles.len());
                assert!(following.len() > 500, "{} triangles in submap {submap}", following.len());
            }
        }
        check_submaps(&slam, poses);
    }
}
