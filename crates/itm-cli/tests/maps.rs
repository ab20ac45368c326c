//! `itm info`, `itm mesh` and `itm render` on a small saved map of two balls.

#![allow(clippy::unwrap_used, reason = "this is a test, and its helpers outside of #[test] functions are too")]

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use glam::{DQuat, DVec3, IVec3, Vec3};
use itm_core::voxel::{BlockKey, ColourVoxel, DistanceKind, DistanceVoxel, VoxelKind};
use itm_core::{Calibration, DepthConversion, Intrinsics, Se3, Settings, StampedPose, Timestamp, Trajectory};
use itm_io::map_file::{MapHeader, MapWriter, SubmapPose, SubmapState, tag};
use serde_json::Value;
use tempfile::TempDir;

const VOXEL_M: f32 = 0.01;
const BAND_M: f32 = 0.05;
/// Centres in metres, and radii.
const BALLS: [(Vec3, f32); 2] = [(Vec3::new(0.0, 0.0, 1.0), 0.3), (Vec3::new(0.5, 0.1, 0.8), 0.08)];

fn distance(p: Vec3) -> f32 {
    BALLS.iter().map(|(centre, radius)| p.distance(*centre) - radius).fold(f32::MAX, f32::min)
}

/// Writes a map whose trajectory goes a little to the side, with so many of its blocks in it.
fn write_map(path: &Path, all: bool) {
    write_submaps(path, &[], |_, _| all);
}

/// Writes a map of submaps, or where none is given of the world's own, each of which has seen what `part` says (in the world).
fn write_submaps(path: &Path, submaps: &[SubmapPose], part: impl Fn(u16, Vec3) -> bool) {
    let kind = VoxelKind { distance: DistanceKind::I16, colour: true, confidence: false };
    let mut settings = Settings::default();
    settings.map.voxel_size_m = VOXEL_M;
    settings.map.truncation_m = BAND_M;
    settings.map.max_weight = 20;
    settings.view.max_depth_m = 2.0;
    let camera = Intrinsics::new(160, 120, 140.0, 140.0, 79.5, 59.5);
    let header = MapHeader::new(&settings, Calibration::registered(camera, DepthConversion::MILLIMETRES), kind);
    let mut writer = MapWriter::create(path, &header).unwrap();
    let blocks = |sink: &mut itm_io::map_file::BlockSink<'_, '_>| -> Result<(), itm_io::Error> {
        let side = || -6..20;
        let positions = || side().flat_map(|z| side().flat_map(move |y| side().map(move |x| IVec3::new(x, y, z))));
        let of_submap = |s: &SubmapPose| (s.submap, s.world_from_submap);
        let poses = if submaps.is_empty() { vec![(0, Se3::IDENTITY)] } else { submaps.iter().map(of_submap).collect() };
        for ((submap, pose), position) in poses.iter().flat_map(|pose| positions().map(move |p| (pose, p))) {
            let voxel = |i: i32| (position * 8 + IVec3::new(i & 7, i >> 3 & 7, i >> 6)).as_vec3() * VOXEL_M;
            let at = |i: i32| pose.transform_point(voxel(i).as_dvec3()).as_vec3();
            if (0..512).all(|i| distance(at(i)).abs() > BAND_M || !part(*submap, at(i))) {
                continue;
            }
            let weight = |p: Vec3| match part(*submap, p) {
                true => {
                    if p.x < 0.0 {
                        4
                    } else {
                        16
                    }
                }
                false => 0,
            };
            let words = (0..512).map(|i| DistanceVoxel::new(distance(at(i)) / BAND_M, weight(at(i))).0);
            let colour = |i| ColourVoxel::new(if at(i).y < 0.0 { [220, 60, 40] } else { [40, 90, 200] }, 9).0;
            let words: Vec<u32> = words.chain((0..512).map(colour)).collect();
            sink.block(BlockKey { submap: *submap, position }, &words)?;
        }
        Ok(())
    };
    writer.blocks(tag::BLOCKS, blocks).unwrap();
    if !submaps.is_empty() {
        writer.submaps(submaps).unwrap();
    }
    let pose = |i: i64| StampedPose {
        timestamp: Timestamp(i * 100_000_000),
        world_from_camera: Se3::new(DQuat::IDENTITY, DVec3::new(0.05 * i as f64, 0.0, 0.0)),
    };
    writer.trajectory(&(0..5).map(pose).collect::<Trajectory>()).unwrap();
    writer.finish().unwrap();
}

fn with_map() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    write_map(&folder.path().join("room.itm"), true);
    folder
}

fn itm(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_itm")).args(arguments).current_dir(folder).output().unwrap()
}

#[track_caller]
fn refused(folder: &Path, arguments: &[&str], status: i32, words: &[&str]) {
    let output = itm(folder, arguments);
    let error = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(status), "{error}");
    assert!(words.iter().all(|word| error.contains(word)), "{words:?} are not all in: {error}");
}

/// What the program prints; `None` where there is no device to run on.
#[track_caller]
fn printed(folder: &Path, arguments: &[&str]) -> String {
    let output = itm(folder, arguments);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

#[expect(clippy::print_stdout, reason = "a test that checks nothing says so")]
fn skipped() -> bool {
    let skipped = std::env::var_os("ITM_SKIP_GPU_TESTS").is_some();
    if skipped {
        println!("skipped, because ITM_SKIP_GPU_TESTS is set");
    }
    skipped
}

#[test]
fn info_tells_what_a_map_holds() {
    let folder = with_map();
    let info: Value = serde_json::from_str(&printed(folder.path(), &["info", "room.itm", "--json"])).unwrap();
    let blocks = info["blocks"].as_u64().unwrap();
    assert!(blocks > 50);
    assert_eq!((&info["device_blocks"], &info["host_blocks"]), (&blocks.into(), &0.into()));
    assert_eq!(info["voxel_bytes"], blocks * 4096);
    assert_eq!(info["format_version"], serde_json::json!([1, 0]));
    assert_eq!(info["poses"], 5);
    assert!((info["trajectory_length_m"].as_f64().unwrap() - 0.2).abs() < 1e-9);
    assert!((info["trajectory_seconds"].as_f64().unwrap() - 0.4).abs() < 1e-9);
    // The larger ball's nearest and the smaller one's rightmost point, with the band and at most a block around them.
    let bounds = |i: usize, axis: usize| info["bounds_m"][i][axis].as_f64().unwrap();
    assert!((0.57..=0.65).contains(&bounds(0, 2)) && (0.63..=0.72).contains(&bounds(1, 0)));
    let tags: Vec<_> = info["sections"].as_array().unwrap().iter().map(|s| s["tag"].as_str().unwrap()).collect();
    assert_eq!(tags, ["HEAD", "BLKS", "TRAJ"]);
    let text = printed(folder.path(), &["info", "room.itm"]);
    for words in ["map format 1.0", "16-bit distances, colours", "5 poses", "0.20 m in 0.4 s", "BLKS"] {
        assert!(text.contains(words), "'{words}' is not in: {text}");
    }
}

#[test]
fn damaged_maps_and_other_files_are_told_apart() {
    let folder = with_map();
    let at = |name: &str| folder.path().join(name);
    let mut bytes = fs::read(at("room.itm")).unwrap();
    fs::write(at("short.itm"), &bytes[..bytes.len() - 40]).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 4;
    fs::write(at("flipped.itm"), &bytes).unwrap();
    fs::write(at("text.itm"), "ply\nformat ascii 1.0\n").unwrap();
    refused(folder.path(), &["info", "flipped.itm"], 1, &["flipped.itm", "section BLKS", "checksum"]);
    refused(folder.path(), &["mesh", "flipped.itm", "-o", "m.ply"], 1, &["flipped.itm", "checksum"]);
    refused(folder.path(), &["info", "short.itm"], 1, &["short.itm"]);
    refused(folder.path(), &["info", "text.itm"], 1, &["text.itm", "map"]);
    refused(folder.path(), &["info", "none.itm"], 1, &["none.itm"]);
    assert!(!at("m.ply").exists());
}

#[test]
fn what_cannot_be_meant_is_refused_before_any_work() {
    // There is no map at all: these are found first.
    let folder = tempfile::tempdir().unwrap();
    let mesh = |more: &[&str], status, words: &[&str]| {
        refused(folder.path(), &[&["mesh", "none.itm"], more].concat(), status, words);
    };
    mesh(&["-o", "room.xyz"], 1, &["room.xyz", ".ply, .obj, .stl or .glb"]);
    mesh(&["-o", "room.glb", "--points"], 1, &["room.glb", ".ply, .pcd or .xyz"]);
    mesh(&["-o", "nowhere/room.ply"], 1, &["'nowhere'", "does not exist"]);
    for bad in ["0", "1.5", "-0.1", "nan", "half"] {
        mesh(&["-o", "room.ply", &format!("--decimate={bad}")], 2, &["above 0 and at most 1", bad]);
    }
    mesh(&["-o", "room.ply", "--crop", "1,2,3"], 2, &["expected 6 finite numbers", "1,2,3"]);
    mesh(&["-o", "room.ply", "--crop=0,0,0,1,-1,1"], 2, &["holds nothing"]);
    let render = |more: &[&str], status, words: &[&str]| {
        refused(folder.path(), &[&["render", "none.itm"], more].concat(), status, words);
    };
    render(&["-o", "a.jpg", "--pose", "0,0,0,0,0,0,1"], 1, &["a.jpg", ".png"]);
    render(&["-o", "a.png", "--pose", "0,0,0,0,0,0,0"], 2, &["--pose"]);
    render(&["-o", "a.png", "--pose", "0,0,0,0,0,0,1", "--every", "2"], 2, &["--every"]);
    render(&["-o", "out", "--fov", "180"], 2, &["between 1 and 170"]);
    render(&["-o", "out", "--trajectory", "t.txt"], 1, &["t.txt"]);
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);

    let path = folder.path().join("empty.itm");
    write_map(&path, false);
    refused(folder.path(), &["mesh", "empty.itm", "-o", "m.ply"], 1, &["'empty.itm' is empty"]);
    refused(folder.path(), &["render", "empty.itm", "-o", "out"], 1, &["'empty.itm' is empty"]);
    assert!(printed(folder.path(), &["info", "empty.itm"]).contains("blocks      0"));
}

/// Vertices and triangles that a PLY's header announces.
fn counts(path: &Path) -> (usize, usize) {
    let bytes = fs::read(path).unwrap();
    let text = String::from_utf8_lossy(&bytes[..bytes.len().min(600)]).into_owned();
    let count = |element: &str| {
        let line = text.lines().find_map(|line| line.strip_prefix(element)).unwrap_or("0");
        line.trim().parse().unwrap()
    };
    (count("element vertex"), count("element face"))
}

#[test]
fn meshes_are_cropped_cleaned_and_decimated() {
    if skipped() {
        return;
    }
    let folder = with_map();
    let mesh = |name: &str, more: &[&str]| {
        printed(folder.path(), &[&["mesh", "room.itm", "-o", name, "--memory", "0"], more].concat());
        counts(&folder.path().join(name))
    };
    let (vertices, triangles) = mesh("all.ply", &[]);
    // Two closed surfaces: V - E + F = 4 with 3 F = 2 E.
    assert_eq!(2 * vertices, triangles + 8);
    let (_, of_one) = mesh("one.ply", &["--components", "3000"]);
    let small_area = BALLS[1].1.powi(2) / BALLS.iter().map(|b| b.1.powi(2)).sum::<f32>();
    let share = 1.0 - of_one as f32 / triangles as f32;
    assert!((share / small_area - 1.0).abs() < 0.2, "{share} of the triangles for {small_area} of the area");
    let (_, few) = mesh("few.ply", &["--decimate", "0.1"]);
    assert!((few as f32 / triangles as f32 - 0.1).abs() < 0.01, "{few} of {triangles}");
    let (_, half) = mesh("half.ply", &["--crop", "-1,-1,0,0,1,2"]);
    assert!(half > triangles / 3 && half < triangles / 2, "{half} of {triangles}");
    let (_, often) = mesh("often.ply", &["--min-weight", "5"]);
    assert!(often > triangles / 2 && often < 2 * triangles / 3 + 100, "{often} of {triangles}");
    let (points, none) = mesh("points.ply", &["--points", "--up", "z-up"]);
    assert_eq!((points, none), (vertices, 0));
    for (name, more) in [("m.obj", None), ("m.stl", None), ("m.GLB", None), ("m.pcd", Some("--points"))] {
        let arguments: Vec<&str> = ["mesh", "room.itm", "-o", name, "-q"].into_iter().chain(more).collect();
        assert_eq!(printed(folder.path(), &arguments), "");
        assert!(fs::metadata(folder.path().join(name)).unwrap().len() > 10_000);
    }
    let nothing = ["mesh", "room.itm", "-o", "no.ply", "--crop", "8,8,8,9,9,9"];
    refused(folder.path(), &nothing, 1, &["nothing is left of"]);
    refused(folder.path(), &["mesh", "room.itm", "-o", "no.ply", "--min-weight", "17"], 1, &["no surface", "17 times"]);
    assert!(!folder.path().join("no.ply").exists());
}

#[test]
fn pictures_show_the_balls_where_they_are() {
    if skipped() {
        return;
    }
    let folder = with_map();
    let pose = ["--pose", "0,0,0,0,0,0,1"];
    let render = |name: &str, more: &[&str]| {
        printed(folder.path(), &[&["render", "room.itm", "-o", name], more].concat());
        image::open(folder.path().join(name)).ok()
    };
    for kind in ["grey", "colour", "normals", "depth", "confidence"] {
        let name = format!("{kind}.png");
        let picture = render(&name, &[&pose[..], &["--kind", kind]].concat()).unwrap().to_rgba8();
        assert_eq!(picture.dimensions(), (160, 120));
        assert_eq!(picture[(79, 59)].0[3], 255);
        assert_eq!(picture[(5, 5)].0[3], 0);
    }
    let [r, _, b, _] = image::open(folder.path().join("colour.png")).unwrap().to_rgba8()[(79, 50)].0;
    assert!(r > b, "the upper half is red");
    let depth = image::open(folder.path().join("depth-mm.png")).unwrap();
    assert!(matches!(depth, image::DynamicImage::ImageLuma16(_)));
    let depth = depth.to_luma16();
    assert!(depth[(79, 59)].0[0].abs_diff(700) <= 2, "{:?}", depth[(79, 59)]);
    assert_eq!(depth[(5, 5)].0[0], 0);

    // A camera behind, turned around.
    let behind = ["--pose=0,0,2.5,0,1,0,0", "--fov", "60", "--size", "200x150", "--max-depth", "3"];
    let picture = render("behind.png", &behind).unwrap().to_rgba8();
    assert_eq!((picture.dimensions(), picture[(99, 74)].0[3]), ((200, 150), 255));

    assert!(render("views", &["--every", "2", "--size", "80x60", "--kind", "normals"]).is_none());
    let mut names: Vec<_> = fs::read_dir(folder.path().join("views"))
        .unwrap()
        .map(|e| e.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    assert_eq!(names, ["000000.png", "000002.png", "000004.png"]);
    fs::write(folder.path().join("t.txt"), "1.0 0 0 0.2 0 0 0 1\n").unwrap();
    render("more", &["--trajectory", "t.txt"]);
    assert!(folder.path().join("more/000000.png").exists());
}

/// The positions in an XYZ file.
fn points_in(path: &Path) -> Vec<Vec3> {
    let point = |line: &str| {
        let numbers: Vec<f32> = line.split_whitespace().take(3).map(|n| n.parse().unwrap()).collect();
        Vec3::from_slice(&numbers)
    };
    fs::read_to_string(path).unwrap().lines().filter(|line| !line.starts_with('#')).map(point).collect()
}

#[test]
fn the_visible_surface_is_written_as_points() {
    if skipped() {
        return;
    }
    let folder = with_map();
    let seen = ["render", "room.itm", "--points", "--pose", "0,0,0,0,0,0,1"];
    let answer = printed(folder.path(), &[&seen[..], &["-o", "seen.xyz", "--json"]].concat());
    let answer: Value = serde_json::from_str(&answer).unwrap();
    let points = points_in(&folder.path().join("seen.xyz"));
    assert!(points.len() > 2_000 && answer["points"] == points.len(), "{answer} but {}", points.len());
    // The last step along a ray is as long as the distance from the surface: rays that graze a ball end short of it.
    let mut off: Vec<f32> = points.iter().map(|p| distance(*p).abs() / VOXEL_M).collect();
    off.sort_by(f32::total_cmp);
    let (median, worst) = (off[off.len() / 2], off[off.len() - 1]);
    assert!(median < 0.03 && worst < 0.5, "half are within {median} voxels of the balls, all within {worst}");
    assert!(points.iter().all(|p| p.z < 1.0), "a point that the camera cannot see");
    refused(folder.path(), &[&seen[..], &["-o", "seen.png"]].concat(), 1, &["seen.png", ".ply"]);
    printed(folder.path(), &["render", "room.itm", "--points", "-o", "clouds", "--every", "4"]);
    assert!(folder.path().join("clouds/000004.ply").exists());
}

#[test]
fn submaps_are_one_map_in_the_world() {
    if skipped() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let turned = Se3::new(DQuat::from_rotation_y(-20_f64.to_radians()), DVec3::new(0.035, 0.0125, 0.0));
    let pose = |submap, world_from_submap, state| SubmapPose { submap, world_from_submap, state };
    let submaps = [pose(0, Se3::IDENTITY, SubmapState::Active), pose(4, turned, SubmapState::Primary)];
    // Both have seen the middle of the larger ball.
    let part = |submap, p: Vec3| if submap == 0 { p.x < 0.15 } else { p.x > -0.15 };
    write_submaps(&folder.path().join("room.itm"), &submaps, part);
    let info: Value = serde_json::from_str(&printed(folder.path(), &["info", "room.itm", "--json"])).unwrap();
    let submap = |i: usize| &info["submaps"][i];
    assert_eq!((&submap(1)["submap"], submap(2)), (&4.into(), &Value::Null));
    assert_eq!(submap(1)["world_from_submap"]["translation"], serde_json::json!([0.035, 0.0125, 0.0]));
    let blocks = |i| submap(i)["blocks"].as_u64().unwrap();
    assert!(blocks(0) > 50 && info["blocks"] == blocks(0) + blocks(1));
    let text = printed(folder.path(), &["info", "room.itm"]);
    for words in ["submaps     2", "at 0.04, 0.01, 0.00 m in the world, turned by 20.0 degrees", "SUBM"] {
        assert!(text.contains(words), "'{words}' is not in: {text}");
    }

    let mesh = |map: &str, name: &str, more: &[&str]| {
        printed(folder.path(), &[&["mesh", map, "-o", name, "--memory", "0"], more].concat());
        counts(&folder.path().join(name))
    };
    let (vertices, triangles) = mesh("room.itm", "all.ply", &[]);
    assert_eq!(2 * vertices, triangles + 8, "two closed surfaces");
    assert_eq!(mesh("room.itm", "fused.ply", &["--fuse-submaps"]), (vertices, triangles));
    mesh("room.itm", "all.xyz", &["--points"]);
    let most = |name: &str, pose: &Se3| {
        let off = |p: Vec3| distance(pose.transform_point(p.as_dvec3()).as_vec3()).abs() / VOXEL_M;
        let points = points_in(&folder.path().join(name));
        (points.len(), points.into_iter().map(off).fold(0.0, f32::max))
    };
    let (count, off) = most("all.xyz", &Se3::IDENTITY);
    assert!(count == vertices && off < 0.1, "{count} points, {off} voxels off");
    // One of them alone, where its own frame has it.
    mesh("room.itm", "one.xyz", &["--points", "--submap", "4"]);
    let (count, off) = most("one.xyz", &turned);
    assert!(count < vertices && count > vertices / 3 && off < 0.1, "{count} points, {off} voxels off");

    let said = printed(folder.path(), &["mesh", "room.itm", "-o", "one.itm", "--fuse-submaps"]);
    assert!(said.contains("in 2 submaps"), "{said}");
    assert_eq!(mesh("one.itm", "one.ply", &[]), (vertices, triangles));
    let one: Value = serde_json::from_str(&printed(folder.path(), &["info", "one.itm", "--json"])).unwrap();
    assert_eq!((&one["submaps"][1], &one["poses"]), (&Value::Null, &5.into()));

    let depth = |name: &str, more: &[&str]| {
        printed(folder.path(), &[&["render", "room.itm", "-o", name, "--kind", "depth"], more].concat());
        let name = name.replace(".png", "-mm.png");
        image::open(folder.path().join(name)).unwrap().to_luma16()[(79, 59)].0[0]
    };
    let found = depth("world.png", &["--pose", "0,0,0,0,0,0,1"]);
    assert!(found.abs_diff(700) <= 2, "{found}");
    let camera = turned.inverse();
    let (t, q) = (camera.translation, camera.rotation);
    let pose = format!("--pose={},{},{},{},{},{},{}", t.x, t.y, t.z, q.x, q.y, q.z, q.w);
    let found = depth("own.png", &["--submap", "4", &pose]);
    assert!(found.abs_diff(700) <= 2, "{found}");

    refused(folder.path(), &["mesh", "room.itm", "-o", "no.ply", "--submap", "2"], 1, &["no submap 2", "[0, 4]"]);
    refused(folder.path(), &["render", "room.itm", "-o", "no", "--submap", "2"], 1, &["no submap 2", "[0, 4]"]);
    refused(folder.path(), &["mesh", "room.itm", "-o", "no.ply", "--submap", "4", "--fuse-submaps"], 2, &["--submap"]);
    let cropped = ["mesh", "room.itm", "-o", "no.itm", "--fuse-submaps", "--crop=0,0,0,1,1,1"];
    refused(folder.path(), &cropped, 1, &["--crop", "no.itm"]);
}
