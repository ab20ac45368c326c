//! Recordings through the public API: every format on small generated folders, what can be wrong with one, and the
//! heads of real ones where there are any.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "the exemption of tests does not reach the helpers of a test that is a crate of its own"
)]

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use glam::DVec3;
use image::{GrayImage, ImageBuffer, Luma, Rgb, RgbImage, Rgba, RgbaImage};
use itm_core::{Calibration, DepthConversion, DepthImage, Distortion, Frame, Image, Intrinsics, Se3, Timestamp};
use itm_io::recording::{self, Format, OpenOptions, ReadAhead, Recording, RecordingInfo};
use itm_io::{Error, calibration};
use tempfile::TempDir;

const WIDTH: u32 = 8;
const HEIGHT: u32 = 6;

/// A recording's folder to put files into; it goes away with this value.
struct Folder {
    _temporary: TempDir,
    path: PathBuf,
}

impl Folder {
    /// The name counts, as formats and presets are recognised by it; the temporary folder's own random name is kept
    /// out of reach.
    fn named(name: &str) -> Self {
        let temporary = tempfile::tempdir().unwrap();
        let path = temporary.path().join("data").join(name);
        fs::create_dir_all(&path).unwrap();
        Self { _temporary: temporary, path }
    }

    fn new() -> Self {
        Self::named("recording")
    }

    fn at(&self, name: &str) -> PathBuf {
        let path = self.path.join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        path
    }

    fn bytes(&self, name: &str, bytes: impl AsRef<[u8]>) -> &Self {
        fs::write(self.at(name), bytes).unwrap();
        self
    }

    /// A depth image full of one value, but for the corner.
    fn depth(&self, name: &str, value: u16) -> &Self {
        self.depth_sized(name, value, (WIDTH, HEIGHT))
    }

    fn depth_sized(&self, name: &str, value: u16, (width, height): (u32, u32)) -> &Self {
        let mut image = ImageBuffer::from_pixel(width, height, Luma([value]));
        image.put_pixel(width - 1, 0, Luma([u16::MAX]));
        image.save(self.at(name)).unwrap();
        self
    }

    fn colour(&self, name: &str, rgb: [u8; 3]) -> &Self {
        RgbImage::from_pixel(WIDTH, HEIGHT, Rgb(rgb)).save(self.at(name)).unwrap();
        self
    }

    /// Cuts a file to half its length.
    fn truncate(&self, name: &str) -> &Self {
        let bytes = fs::read(self.at(name)).unwrap();
        self.bytes(name, &bytes[..bytes.len() / 2])
    }

    fn calibration(&self, name: &str) -> Calibration {
        let camera = |f| Intrinsics::new(WIDTH, HEIGHT, f, f, 3.5, 2.5);
        let calibration = Calibration {
            colour: camera(11.0),
            colour_from_depth: Se3 { translation: DVec3::new(-0.1, 0.0, 0.0), ..Se3::IDENTITY },
            ..Calibration::registered(camera(10.0), DepthConversion::Affine { scale: 0.25, offset: 0.5 })
        };
        calibration::write(&self.at(name), &calibration).unwrap();
        calibration
    }

    fn open(&self) -> Result<Box<dyn Recording>, String> {
        self.open_with(&OpenOptions::default())
    }

    fn open_with(&self, options: &OpenOptions) -> Result<Box<dyn Recording>, String> {
        recording::open(&self.path, options).map_err(|e| e.to_string())
    }

    /// The error of a recording that cannot be opened, with its folder's path left out.
    fn error(&self) -> String {
        self.error_with(&OpenOptions::default())
    }

    fn error_with(&self, options: &OpenOptions) -> String {
        let error = self.open_with(options).map(|r| r.info().clone()).expect_err("should not open");
        error.replace(self.path.to_str().unwrap(), "HERE")
    }

    /// A frame's error, likewise.
    fn frame_error(&self, recording: &mut dyn Recording, index: usize) -> String {
        let error = recording.read(index).expect_err("should not be read").to_string();
        error.replace(self.path.to_str().unwrap(), "HERE")
    }
}

fn patterns(depth: &str, colour: &str) -> OpenOptions {
    OpenOptions { depth_pattern: Some(depth.into()), colour_pattern: Some(colour.into()), ..OpenOptions::default() }
}

/// The first raw depth value of a frame.
fn raw(frame: &Frame) -> u16 {
    match &frame.depth {
        DepthImage::Raw(image) => image.data()[0],
        DepthImage::Metres(_) => panic!("files hold raw depth"),
    }
}

fn first_colour(frame: &Frame) -> Option<[u8; 4]> {
    frame.colour.as_ref().map(|image| image.data()[0])
}

/// Three pairs with 33 ms between them.
fn tum() -> Folder {
    tum_named("recording")
}

fn tum_named(name: &str) -> Folder {
    let folder = Folder::named(name);
    for i in 0..3_u8 {
        folder.depth(&format!("depth/{i}.png"), 1000 + u16::from(i)).colour(&format!("rgb/{i}.png"), [i, 2, 3]);
    }
    folder
        .bytes("depth.txt", "# depth maps\n10.000001 depth/0.png\n10.033 depth/1.png\n10.066 depth/2.png\n")
        .bytes("rgb.txt", "# colour\r\n\r\n10.005\trgb/0.png\r\n10.030\trgb/1.png\r\n10.070\trgb/2.png\r\n");
    folder
}

#[test]
fn tum_lists_are_associated_and_keep_every_digit_of_a_time() {
    let folder = tum();
    folder.bytes("groundtruth.txt", "# t\n10.002 1 2 3 0 0 0 1\n10.03 4 5 6 0 0 0 1\n10.5 7 8 9 0 0 0 1\n");
    let mut recording = folder.open().unwrap();
    let info = recording.info().clone();
    assert_eq!((info.format, info.frames, info.name.as_str()), (Format::Tum, 3, "recording"));
    assert!(info.has_timestamps && info.has_colour);
    assert_eq!(info.image_number(Timestamp(10)), None);
    assert_eq!(info.ground_truth.unwrap().len(), 3);
    assert_eq!(info.calibration.depth_conversion, DepthConversion::TUM);
    assert_eq!(info.calibration.colour_from_depth, Se3::IDENTITY);

    let frames: Vec<Frame> = (0..3).map(|i| recording.read(i).unwrap()).collect();
    let times: Vec<i64> = frames.iter().map(|frame| frame.timestamp.0).collect();
    assert_eq!(times, [10_000_001_000, 10_033_000_000, 10_066_000_000]);
    assert_eq!(frames.iter().map(|frame| frame.index).collect::<Vec<_>>(), [0, 1, 2]);
    assert_eq!(frames.iter().map(raw).collect::<Vec<_>>(), [1000, 1001, 1002]);
    assert_eq!(first_colour(&frames[1]), Some([1, 2, 3, 255]));
    let place = |frame: &Frame| frame.world_from_camera.map(|pose| pose.translation);
    assert_eq!(place(&frames[0]), Some(DVec3::new(1.0, 2.0, 3.0)));
    assert_eq!(place(&frames[1]), Some(DVec3::new(4.0, 5.0, 6.0)));
    assert_eq!(place(&frames[2]), None, "the nearest pose is 36 ms away");
    let DepthImage::Raw(image) = &frames[0].depth else { panic!("files hold raw depth") };
    assert_eq!(image.get(WIDTH - 1, 0), Some(&u16::MAX), "rows come one after the other");
    assert_eq!(image.get(0, 1), Some(&1000));
}

#[test]
fn tum_depth_without_colour_is_left_out_and_counted() {
    let folder = tum();
    folder.bytes("rgb.txt", "10.005 rgb/0.png\n10.070 rgb/2.png\n");
    let recording = folder.open().unwrap();
    assert_eq!((recording.info().frames, recording.info().depth_without_colour), (2, 1));
}

#[test]
fn tum_runs_on_depth_alone() {
    let folder = tum();
    fs::remove_file(folder.at("rgb.txt")).unwrap();
    let mut recording = folder.open().unwrap();
    assert_eq!((recording.info().frames, recording.info().has_colour), (3, false));
    assert!(recording.read(2).unwrap().colour.is_none());
}

#[test]
fn tum_associations_may_have_depth_or_colour_first() {
    for (first, second) in [("depth", "rgb"), ("rgb", "depth")] {
        let folder = tum();
        let line = |i| format!("1{i}.25 {first}/{i}.png 1{i}.5 {second}/{i}.png\n");
        folder.bytes("associations.txt", line(1) + &line(0));
        let mut recording = folder.open().unwrap();
        assert_eq!(recording.info().frames, 2);
        let frame = recording.read(0).unwrap();
        assert_eq!((raw(&frame), first_colour(&frame)), (1000, Some([0, 2, 3, 255])), "in the order of time");
        let depth_time = if first == "depth" { 10_250_000_000 } else { 10_500_000_000 };
        assert_eq!(frame.timestamp.0, depth_time, "the time is that of depth");
    }
    // Where the names do not tell, the pixels do.
    let folder = Folder::new();
    folder.depth("a/1.png", 7).colour("b/1.png", [1, 2, 3]).bytes("associations.txt", "1 b/1.png 2 a/1.png\n");
    let frame = folder.open().unwrap().read(0).unwrap();
    assert_eq!((raw(&frame), first_colour(&frame), frame.timestamp.0), (7, Some([1, 2, 3, 255]), 2_000_000_000));
}

#[test]
fn tum_presets_follow_the_path_and_the_lists_comments() {
    let info = |folder: &Folder| folder.open().unwrap().info().clone();
    let fx_of_640 = |info: &RecordingInfo| info.calibration.depth.fx * 640.0 / f64::from(WIDTH);

    let info_fr2 = info(&tum_named("freiburg1/rgbd_dataset_freiburg2_xyz"));
    assert!((fx_of_640(&info_fr2) - 520.9).abs() < 1e-9, "the deepest folder wins");
    let source = &info_fr2.calibration_source;
    assert!(source.contains("fr2") && source.contains("'rgbd_dataset_freiburg2_xyz'"), "{source}");
    assert!(source.ends_with("scaled from 640x480 to the images' size"), "{source}");
    assert_eq!(info_fr2.calibration.depth.width, WIDTH);

    let info_fr1 = info(&tum_named("fr1/desk"));
    assert!((fx_of_640(&info_fr1) - 517.3).abs() < 1e-9);

    let folder = tum();
    let renamed = info(&folder);
    assert!((fx_of_640(&renamed) - 525.0).abs() < 1e-9);
    assert!(renamed.calibration_source.starts_with("ROS default"), "{}", renamed.calibration_source);
    let list = fs::read_to_string(folder.at("depth.txt")).unwrap();
    folder.bytes("depth.txt", format!("# file: 'rgbd_dataset_freiburg3_office.bag'\n{list}"));
    let by_comment = info(&folder);
    assert!((fx_of_640(&by_comment) - 535.4).abs() < 1e-9);
    assert!(by_comment.calibration_source.contains("depth.txt"), "{}", by_comment.calibration_source);
    assert!(by_comment.calibration.colour_distortion.is_none(), "undistorted already");
    assert!(info_fr2.calibration_source.contains("lens") && info_fr2.calibration.validate().is_ok());
}

#[test]
fn presets_keep_their_digits_at_their_own_size() {
    let folder = Folder::named("fr1");
    folder.depth_sized("depth/0.png", 1, (640, 480)).bytes("depth.txt", "1 depth/0.png\n");
    let recording = folder.open().unwrap();
    assert_eq!(recording.info().calibration.depth, Intrinsics::new(640, 480, 517.3, 516.5, 318.6, 255.3));
    assert_eq!(
        recording.info().calibration_source,
        "TUM preset fr1 with its lens's distortion, recognised from 'fr1' in the path"
    );
    let lens = Distortion::brown([0.2624, -0.9531, -0.0054, 0.0026, 1.1633]);
    assert_eq!(recording.info().calibration.colour_distortion, lens);
    assert_eq!(recording.info().calibration.depth_distortion, lens);
    assert_eq!(recording.info().calibration.validate(), Ok(()));
}

#[test]
fn a_calibration_file_wins_over_a_preset_and_a_named_one_over_it() {
    let folder = tum_named("fr1");
    let calibration = folder.calibration("calib.txt");
    let recording = folder.open().unwrap();
    assert_eq!(recording.info().calibration, calibration);
    assert!(recording.info().calibration_source.ends_with("calib.txt'"), "{}", recording.info().calibration_source);

    let other = folder.at("elsewhere/mine.txt");
    calibration::write(&other, &Calibration { depth_conversion: DepthConversion::MILLIMETRES, ..calibration }).unwrap();
    let recording = folder.open_with(&OpenOptions { calibration: Some(other), ..OpenOptions::default() }).unwrap();
    assert_eq!(recording.info().calibration.depth_conversion, DepthConversion::MILLIMETRES);
    assert!(recording.info().calibration_source.ends_with("mine.txt'"), "{}", recording.info().calibration_source);
}

#[test]
fn a_gyroscopes_readings_go_to_the_frame_that_ends_them() {
    let folder = tum();
    folder.bytes(
        "gyroscope.txt",
        "# timestamp wx wy wz\n9.9 9 9 9\n10.0 0 0 0\n10.02 1 0.5 -2\r\n10.033 2 0 0\n\n10.04 3 0 0\n10.05 4 0 0\n10.1 5 0 0\n\
         10.000001 0.1 0 0\n",
    );
    let mut recording = folder.open().unwrap();
    assert!(recording.info().has_gyroscope && !recording.info().has_imu_orientation);
    let frames: Vec<Frame> = (0..3).map(|i| recording.read(i).unwrap()).collect();
    let rates = |frame: &Frame| frame.gyroscope.iter().map(|reading| reading.rad_per_s.x).collect::<Vec<_>>();
    assert_eq!(rates(&frames[0]), [0.1], "the last before the first frame, or at it");
    assert_eq!(rates(&frames[1]), [1.0, 2.0]);
    assert_eq!(rates(&frames[2]), [3.0, 4.0], "later ones belong to no frame");
    let reading = frames[1].gyroscope[0];
    assert_eq!((reading.timestamp.0, reading.rad_per_s), (10_020_000_000, DVec3::new(1.0, 0.5, -2.0)));

    // Of no use, but no reason to refuse the recording.
    folder.bytes("gyroscope.txt", "# timestamp wx wy wz\n");
    assert!(!folder.open().unwrap().info().has_gyroscope);
    for bad in ["10 1 2", "10 1 2 3 4", "ten 1 2 3", "10 1 nan 3", "10 1 2 three"] {
        let error = folder.bytes("gyroscope.txt", format!("# w\n10 0 0 0\n{bad}\n")).error();
        assert!(error.starts_with("'HERE/gyroscope.txt', line 3: expected 4 finite numbers"), "{error}");
        assert!(error.ends_with(&format!("found '{bad}'")), "{error}");
    }
}

fn orientations(pattern: &str) -> OpenOptions {
    OpenOptions { imu_pattern: Some(pattern.into()), ..OpenOptions::default() }
}

#[test]
fn orientations_are_rotation_files_with_the_images_numbers() {
    let quarter = "0 -1 0\n1 0 0\n0 0 1\n";
    let turned = |frame: &Frame| frame.imu_orientation.map(|q| (q * DVec3::X).round());
    // 7-Scenes and ICL-NUIM number their images, TUM does not.
    let scenes = Folder::new();
    seven_scenes(&scenes, "");
    let icl = Folder::named("living_room_traj1");
    icl.depth("depth/1.png", 1).depth("depth/2.png", 2).depth("depth/5.png", 5);
    for (folder, number, frame) in [(scenes, 1, 1), (icl, 5, 2), (tum(), 2, 2)] {
        folder.bytes(&format!("imu/{number:04}.txt"), quarter).bytes("imu/0099.txt", "");
        let mut recording = folder.open_with(&orientations("imu/%04d.txt")).unwrap();
        assert!(recording.info().has_imu_orientation && !recording.info().has_gyroscope);
        for i in 0..3 {
            let expected = (i == frame).then_some(DVec3::Y);
            assert_eq!(turned(&recording.read(i).unwrap()), expected, "{}: frame {i}", recording.info().format);
        }
        assert!(!folder.open().unwrap().info().has_imu_orientation, "only where it is asked for");
    }

    let folder = Folder::new();
    folder.calibration("calibration.txt");
    folder.depth("depth_07.png", 7).depth("depth_10.png", 10).bytes("imu_7.txt", "1 0 0 0 0 -1 0 1 0");
    let options = OpenOptions { imu_pattern: Some("imu_*.txt".into()), ..OpenOptions::default() };
    let mut recording = folder.open_with(&options).unwrap();
    let orientation = recording.read(0).unwrap().imu_orientation.unwrap();
    assert!((orientation * DVec3::Y).abs_diff_eq(DVec3::Z, 1e-12) && orientation.is_normalized());
    assert_eq!(recording.read(1).unwrap().imu_orientation, None);
}

#[test]
fn bad_orientations_are_named() {
    let folder = tum();
    let missing = folder.error_with(&orientations("imu/%d.txt"));
    assert_eq!(missing, "'HERE/imu' does not exist");
    folder.bytes("imu/7.txt", "1 0 0 0 1 0 0 0 1");
    let others = folder.error_with(&orientations("imu/%d.txt"));
    assert_eq!(others, "'HERE' holds no rotation files named as 'imu/%d.txt' with the images' numbers (1 with others)");
    assert!(folder.error_with(&orientations("imu/7.txt")).contains("must have one number"));

    folder.bytes("imu/0.txt", "1 0 0\n0 1 0\n0 0 1.05\n").bytes("imu/1.txt", "1 0 0\n0 x 0\n0 0 1\n");
    let mut recording = folder.open_with(&orientations("imu/%d.txt")).unwrap();
    let scaled = folder.frame_error(&mut *recording, 0);
    assert!(scaled.starts_with("frame 0: 'HERE/imu/0.txt', line 1: expected 9 finite numbers"), "{scaled}");
    assert!(scaled.contains("must be a rotation"), "{scaled}");
    let word = folder.frame_error(&mut *recording, 1);
    assert!(word.starts_with("frame 1: 'HERE/imu/1.txt', line 2") && word.ends_with("found 'x'"), "{word}");
    assert_eq!(recording.read(2).unwrap().imu_orientation, None);
}

#[test]
fn icl_nuim_numbers_its_images_and_has_negative_fy() {
    let folder = Folder::new();
    let mut associations = String::new();
    for i in 0..12_u8 {
        folder.depth(&format!("depth/{i}.png"), i.into()).colour(&format!("rgb/{i}.png"), [i, 0, 0]);
        associations += &format!("{i} depth/{i}.png {i} rgb/{i}.png\n");
    }
    let truth: String = (1..12).map(|i| format!("{i} {i} 0 0 0 0 0 1\n")).collect();
    folder.bytes("associations.txt", associations).bytes("livingRoom9.gt.freiburg", truth);

    let mut recording = folder.open().unwrap();
    let info = recording.info().clone();
    assert_eq!((info.format, info.frames, info.has_timestamps), (Format::IclNuim, 12, false));
    assert!(info.calibration.depth.fy < 0.0 && info.calibration_source.contains("-480"));
    assert_eq!(recording.read(0).unwrap().world_from_camera, None, "image 0 has no pose");
    for i in 1..12 {
        let frame = recording.read(i).unwrap();
        assert_eq!(frame.world_from_camera.unwrap().translation.x, i as f64);
        assert_eq!(usize::from(raw(&frame)), i, "in the order of numbers, not of names");
        assert_eq!(info.image_number(frame.timestamp), Some(i as u64));
        let truth = info.ground_truth.as_ref().unwrap().nearest(frame.timestamp, 0).unwrap();
        assert_eq!(truth.world_from_camera.translation.x, i as f64);
    }
    assert_eq!(recording.read(3).unwrap().timestamp.0, 100_000_000, "30 images a second");
}

#[test]
fn icl_nuim_needs_no_associations_below_a_telling_name() {
    let folder = Folder::named("living_room_traj1_frei_png");
    for i in [0, 2, 10_u8] {
        folder.depth(&format!("depth/{i}.png"), i.into()).colour(&format!("rgb/{i}.png"), [i, 0, 0]);
    }
    let mut recording = folder.open().unwrap();
    assert_eq!((recording.info().format, recording.info().frames), (Format::IclNuim, 3));
    let last = recording.read(2).unwrap();
    assert_eq!((raw(&last), recording.info().image_number(last.timestamp)), (10, Some(10)));
}

#[test]
fn every_nominal_time_gives_its_number_back() {
    let folder = Folder::named("traj");
    let recording = folder.depth("depth/0.png", 1).open().unwrap();
    for number in (0..5000).chain([u32::MAX - 1, u32::MAX]) {
        let time = recording::nominal_timestamp(number);
        assert_eq!(recording.info().image_number(time), Some(number.into()));
    }
}

fn seven_scenes(folder: &Folder, below: &str) {
    for i in 0..3_u8 {
        folder.depth(&format!("{below}frame-00000{i}.depth.png"), 500 + u16::from(i));
        folder.colour(&format!("{below}frame-00000{i}.color.png"), [9, 9, i]);
        folder.bytes(
            &format!("{below}frame-00000{i}.pose.txt"),
            format!("0 -1 0 {i}\t\r\n1 0 0 0\t\r\n0 0 1 5e-01\t\r\n0 0 0 1\t\r\n"),
        );
    }
}

#[test]
fn seven_scenes_is_two_cameras_and_camera_to_world_matrices() {
    let folder = Folder::new();
    seven_scenes(&folder, "");
    let mut recording = folder.open().unwrap();
    let info = recording.info().clone();
    assert_eq!((info.format, info.frames, info.has_timestamps), (Format::SevenScenes, 3, false));
    assert_eq!(info.calibration.depth_conversion, DepthConversion::MILLIMETRES);
    assert!(info.calibration.colour_from_depth.translation.x < 0.0, "the colour camera sits to the right");
    assert!(info.calibration.depth.fx > info.calibration.colour.fx);
    let frame = recording.read(2).unwrap();
    assert_eq!(
        (raw(&frame), first_colour(&frame), info.image_number(frame.timestamp)),
        (502, Some([9, 9, 2, 255]), Some(2))
    );
    let world_point = frame.world_from_camera.unwrap().transform_point(DVec3::X);
    assert!(world_point.abs_diff_eq(DVec3::new(2.0, 1.0, 0.5), 1e-12), "{world_point}");
    assert_eq!(info.ground_truth.unwrap().len(), 3);
}

#[test]
fn seven_scenes_opens_the_folder_of_one_sequence_and_asks_which_of_several() {
    let folder = Folder::new();
    seven_scenes(&folder, "seq-02/");
    fs::create_dir(folder.at("seq-03")).unwrap();
    let recording = folder.open().unwrap();
    assert_eq!((recording.info().frames, recording.info().name.as_str()), (3, "seq-02"), "seq-03 is empty");
    seven_scenes(&folder, "seq-01/");
    assert_eq!(folder.error(), "'HERE' holds several recordings (seq-01, seq-02); name one of them");
}

#[test]
fn seven_scenes_goes_without_a_pose_that_cannot_be_meant() {
    let folder = Folder::new();
    seven_scenes(&folder, "");
    folder.bytes("frame-000000.pose.txt", "nan nan nan nan\n".repeat(4));
    folder.bytes("frame-000001.pose.txt", "1 0 0\n");
    fs::remove_file(folder.at("frame-000002.pose.txt")).unwrap();
    let mut recording = folder.open().unwrap();
    assert!((0..3).all(|i| recording.read(i).unwrap().world_from_camera.is_none()));
    assert_eq!(recording.info().ground_truth, None);
}

#[test]
fn seven_scenes_reports_an_image_that_is_missing_at_its_frame() {
    let folder = Folder::new();
    seven_scenes(&folder, "");
    fs::remove_file(folder.at("frame-000001.color.png")).unwrap();
    fs::remove_file(folder.at("frame-000002.depth.png")).unwrap();
    let mut recording = folder.open().unwrap();
    assert_eq!(recording.info().frames, 3);
    let error = folder.frame_error(&mut *recording, 1);
    assert!(error.starts_with("frame 1: cannot open 'HERE/frame-000001.color.png': "), "{error}");
    let error = folder.frame_error(&mut *recording, 2);
    assert!(error.starts_with("frame 2: cannot open 'HERE/frame-000002.depth.png': "), "{error}");
}

/// A 16-bit PGM, whose bytes come big end first.
fn pgm(values: &[u16], largest: u16) -> Vec<u8> {
    let mut bytes = format!("P5\n# made for a test\n{WIDTH} {HEIGHT}\n{largest}\n").into_bytes();
    bytes.extend(values.iter().flat_map(|v| v.to_be_bytes()));
    bytes
}

#[test]
fn image_folders_follow_patterns_and_need_a_calibration_file() {
    let folder = Folder::new();
    let values: Vec<u16> = (0..(WIDTH * HEIGHT) as u16).map(|i| i * 100 + 1).collect();
    for i in [2, 10] {
        folder
            .bytes(&format!("Frames/{i:04}.pgm"), pgm(&values, 10_000))
            .colour(&format!("Frames/{i:04}.ppm"), [4, 5, i]);
    }
    let with_patterns = patterns("Frames/%04i.pgm", "Frames/%04i.ppm");
    assert!(folder.error_with(&with_patterns).contains("calibration.txt"), "{}", folder.error_with(&with_patterns));
    let calibration = folder.calibration("calib.txt");
    // The report's names are also found without patterns.
    for options in [with_patterns, OpenOptions::default()] {
        let mut recording = folder.open_with(&options).unwrap();
        let info = recording.info();
        assert_eq!((info.format, info.frames, info.has_timestamps, info.has_colour), (Format::Images, 2, false, true));
        assert_eq!(info.calibration, calibration);
        let frame = recording.read(1).unwrap();
        assert_eq!(first_colour(&frame), Some([4, 5, 10, 255]));
        assert_eq!(frame.depth, DepthImage::Raw(Image::new(WIDTH, HEIGHT, values.clone()).unwrap()), "not stretched");
        assert_eq!(frame.timestamp, recording::nominal_timestamp(1));
    }
}

#[test]
fn image_folders_are_sorted_by_number_and_paired_by_it() {
    let folder = Folder::new();
    folder.calibration("calibration.txt");
    for i in [1, 2, 10_u8] {
        folder.depth(&format!("depth_{i}.png"), i.into());
    }
    folder.colour("rgb_2.jpg", [200; 3]).colour("rgb_10.jpg", [200; 3]).colour("rgb_11.jpg", [200; 3]);
    let mut recording = folder.open().unwrap();
    assert_eq!((recording.info().format, recording.info().frames), (Format::Images, 3));
    assert_eq!(recording.read(2).map(|frame| raw(&frame)).unwrap(), 10);
    let error = folder.frame_error(&mut *recording, 0);
    assert!(error.starts_with("frame 0: cannot open 'HERE/rgb_1.jpg': "), "{error}");
}

#[test]
fn grey_and_transparent_colour_images_become_opaque_colour() {
    let folder = Folder::new();
    folder.calibration("calibration.txt");
    folder.depth("depth/1.png", 1).depth("depth/2.png", 1);
    GrayImage::from_pixel(WIDTH, HEIGHT, Luma([77])).save(folder.at("rgb/1.png")).unwrap();
    RgbaImage::from_pixel(WIDTH, HEIGHT, Rgba([1, 2, 3, 4])).save(folder.at("rgb/2.png")).unwrap();
    let mut recording = folder.open().unwrap();
    assert_eq!(first_colour(&recording.read(0).unwrap()), Some([77, 77, 77, 255]));
    assert_eq!(first_colour(&recording.read(1).unwrap()), Some([1, 2, 3, 255]));
}

#[test]
fn patterns_that_match_nothing_are_named() {
    let folder = Folder::new();
    folder.calibration("calib.txt");
    assert!(folder.error().starts_with("'HERE' has no frames: expected depth images named as one of depth/*.png"));
    folder.depth("depth/1.png", 1).colour("rgb/2.png", [0; 3]);
    let error = folder.error_with(&patterns("depth/%d.pgm", "rgb/%d.png"));
    assert_eq!(error, "'HERE' has no frames: expected depth images named as 'depth/%d.pgm'");
    let error = folder.error_with(&patterns("depth/%d.png", "rgb/%d.png"));
    assert!(error.contains("'rgb/%d.png' with the depth images' numbers (1 with other numbers)"), "{error}");
    assert_eq!(folder.error_with(&patterns("d/*.png", "rgb/*.png")), "'HERE/d' does not exist");
}

#[test]
fn a_path_that_is_no_recording_is_named() {
    let folder = Folder::new();
    let missing = recording::open(&folder.path.join("nowhere"), &OpenOptions::default()).err().unwrap();
    assert!(matches!(&missing, Error::NotFound { path } if path.ends_with("nowhere")), "{missing}");
    folder.bytes("file", "");
    let file = recording::open(&folder.path.join("file"), &OpenOptions::default()).err().unwrap();
    assert!(matches!(&file, Error::NotAFolder { path } if path.ends_with("file")), "{file}");
    let unknown = folder.error();
    assert!(unknown.starts_with("'HERE' is of no known format; looked for depth.txt"), "{unknown}");
    for format in ["TUM", "ICL-NUIM", "7-Scenes", "MCAP", "calibration.txt"] {
        assert!(unknown.contains(format), "{unknown}");
    }
    assert_eq!(
        "kitti".parse::<Format>().unwrap_err().to_string(),
        "'kitti' is no known format of recordings; there are tum, icl-nuim, 7-scenes, mcap, images"
    );
    for format in Format::ALL {
        assert_eq!(format.to_string().parse::<Format>().unwrap(), format);
        let error = folder.error_with(&OpenOptions { format: Some(format), ..OpenOptions::default() });
        assert!(error.contains("HERE"), "an empty folder is no {format} recording: {error}");
    }
}

#[test]
fn lists_that_cannot_be_read_are_named_with_the_line() {
    let folder = tum();
    folder.bytes("rgb.txt", "# colour\n10.005 rgb/0.png\n10,030 rgb/1.png\n");
    assert_eq!(
        folder.error(),
        "'HERE/rgb.txt', line 3: expected a time stamp and a file name, found '10,030 rgb/1.png'"
    );
    folder.bytes("rgb.txt", "# nothing\n");
    assert_eq!(folder.error(), "'HERE/rgb.txt' has no frames: expected lines with a time stamp and a file name");
    fs::remove_file(folder.at("depth.txt")).unwrap();
    assert_eq!(folder.error(), "'HERE/depth.txt' does not exist");

    let folder = tum();
    folder.bytes("groundtruth.txt", "# t\n10.0 1 2 3 0 0 0 1\n10.1 nan 2 3 0 0 0 1\n");
    assert!(
        folder.error().starts_with("'HERE/groundtruth.txt', line 3: expected finite numbers"),
        "{}",
        folder.error()
    );

    let folder = tum();
    folder.bytes("associations.txt", "1 depth/0.png 1 rgb/0.png\n1 depth/0.png 1\n");
    let error = folder.error();
    assert!(error.starts_with("'HERE/associations.txt', line 2: expected 4 values"), "{error}");
    assert!(error.ends_with("found 3: '1 depth/0.png 1'"), "{error}");

    folder.bytes("x.gt.freiburg", "1 0 0 0 0 0 0 1\n").bytes("associations.txt", "1.5 depth/0.png 1 rgb/0.png\n");
    let error = folder.error();
    assert!(error.starts_with("'HERE/associations.txt', line 1: expected an image number"), "{error}");
}

#[test]
fn no_association_within_20_ms_says_how_far_apart_the_images_are() {
    let folder = tum();
    folder.bytes("rgb.txt", "10.0905 rgb/0.png\n11 rgb/1.png\n");
    assert_eq!(
        folder.error(),
        "none of the 3 depth images in 'HERE/depth.txt' has a colour image in 'HERE/rgb.txt' (2 images) within 20 ms; \
         the closest two are 0.0245 s apart"
    );
}

#[test]
fn a_calibration_with_a_wrong_number_of_values_is_named_with_the_line() {
    let folder = tum();
    folder.calibration("calibration.txt");
    let text = fs::read_to_string(folder.at("calibration.txt")).unwrap().replace("11 11\n", "11 11 0\n");
    folder.bytes("calibration.txt", text);
    assert_eq!(
        folder.error(),
        "'HERE/calibration.txt', line 2: expected 2 values (fx and fy of the colour camera), found 3 values: '11 11 0'"
    );
}

#[test]
fn depth_with_8_bits_is_refused() {
    let folder = tum();
    let grey = GrayImage::new(WIDTH, HEIGHT);
    grey.save(folder.at("depth/1.png")).unwrap();
    let mut recording = folder.open().unwrap();
    assert_eq!(
        folder.frame_error(&mut *recording, 1),
        "frame 1: 'HERE/depth/1.png': expected 16-bit greyscale depth, found 8-bit greyscale"
    );
    assert!(recording.read(2).is_ok());
    // Where no image will do there is nothing to run on.
    grey.save(folder.at("depth/0.png")).unwrap();
    folder.colour("depth/2.png", [0; 3]);
    assert_eq!(folder.error(), "'HERE/depth/0.png': expected 16-bit greyscale depth, found 8-bit greyscale");

    let folder = Folder::new();
    folder.calibration("calib.txt");
    folder.bytes("1.pgm", pgm(&[0; (WIDTH * HEIGHT) as usize], 255));
    assert_eq!(folder.error(), "'HERE/1.pgm': expected 16-bit greyscale depth, found 8-bit greyscale");
}

#[test]
fn depth_in_the_place_of_colour_is_refused() {
    let folder = tum();
    folder.depth("rgb/1.png", 5);
    let mut recording = folder.open().unwrap();
    assert_eq!(
        folder.frame_error(&mut *recording, 1),
        "frame 1: 'HERE/rgb/1.png': expected 8-bit colour or greyscale, found 16-bit greyscale"
    );
}

#[test]
fn images_of_another_size_are_named_with_both_sizes() {
    let folder = tum();
    folder.depth_sized("depth/1.png", 1, (9, 5));
    let mut recording = folder.open().unwrap();
    let message = "'HERE/depth/1.png': expected an image of 8x6 pixels as in the calibration, found 9x5";
    assert_eq!(folder.frame_error(&mut *recording, 1), format!("frame 1: {message}"));

    for i in 0..3 {
        folder.depth_sized(&format!("depth/{i}.png"), 1, (9, 5));
    }
    folder.calibration("calibration.txt");
    assert_eq!(folder.error(), message.replace("1.png", "0.png"));
    // Without a calibration file the preset follows the images; colour of another size than depth is fine.
    fs::remove_file(folder.at("calibration.txt")).unwrap();
    let mut recording = folder.open().unwrap();
    let Calibration { depth, colour, .. } = recording.info().calibration;
    assert_eq!(((depth.width, depth.height), (colour.width, colour.height)), ((9, 5), (8, 6)));
    let frame = recording.read(0).unwrap();
    assert_eq!((frame.depth.size(), frame.colour.unwrap().size()), ((9, 5), (8, 6)));
}

#[test]
fn truncated_images_are_reported_and_the_run_goes_on() {
    let folder = tum();
    // Values without a pattern, so that half of the file holds only half of the image.
    let noise = |x: u32, y: u32| (x * 7919 + y * 104_729) as u16;
    ImageBuffer::from_fn(WIDTH, HEIGHT, |x, y| Luma([noise(x, y)])).save(folder.at("depth/1.png")).unwrap();
    folder.truncate("depth/1.png");
    let recording = folder.open().unwrap();
    let results: Vec<_> = ReadAhead::new(recording, 0..3, ReadAhead::DEFAULT_FRAMES).collect();
    assert_eq!(results.iter().map(Result::is_ok).collect::<Vec<_>>(), [true, false, true]);
    let error = results[1].as_ref().unwrap_err().to_string().replace(folder.path.to_str().unwrap(), "HERE");
    assert!(error.starts_with("frame 1: cannot decode 'HERE/depth/1.png': "), "{error}");

    let folder = Folder::new();
    folder.calibration("calib.txt");
    let full = pgm(&[1; (WIDTH * HEIGHT) as usize], u16::MAX);
    folder.bytes("depth/1.pgm", &full).bytes("depth/2.pgm", &full[..full.len() - 2]).bytes("depth/3.pgm", "P5\n8");
    for i in 1..=3 {
        RgbImage::from_fn(WIDTH, HEIGHT, |x, y| Rgb([noise(x, y) as u8; 3]))
            .save(folder.at(&format!("rgb/{i}.jpg")))
            .unwrap();
    }
    folder.truncate("rgb/1.jpg");
    let mut recording = folder.open().unwrap();
    assert_eq!(
        folder.frame_error(&mut *recording, 0),
        "frame 0: cannot decode 'HERE/rgb/1.jpg': it is cut off: no end marker"
    );
    assert_eq!(
        folder.frame_error(&mut *recording, 1),
        "frame 1: cannot decode 'HERE/depth/2.pgm': it is cut off: 8x6 pixels, but only 47 values"
    );
    assert!(folder.frame_error(&mut *recording, 2).starts_with("frame 2: cannot decode 'HERE/depth/3.pgm': "));
}

#[test]
fn files_that_are_no_images_are_refused() {
    let folder = tum();
    folder.bytes("depth/1.png", "hello").bytes("depth/2.png", "");
    let mut recording = folder.open().unwrap();
    for i in [1, 2] {
        let error = folder.frame_error(&mut *recording, i);
        assert_eq!(error, format!("frame {i}: cannot decode 'HERE/depth/{i}.png': not a PNG, JPEG, PGM or PPM image"));
    }
    assert_eq!(recording.read(3).unwrap_err().to_string(), "frame 3 was asked for, but the recording has 3 frames");
}

/// A recording that counts how often it was read.
struct Counting {
    info: RecordingInfo,
    reads: Arc<AtomicUsize>,
}

impl Counting {
    fn new() -> (Box<Self>, Arc<AtomicUsize>) {
        let folder = tum();
        let reads = Arc::new(AtomicUsize::new(0));
        (Box::new(Self { info: folder.open().unwrap().info().clone(), reads: reads.clone() }), reads)
    }
}

impl Recording for Counting {
    fn info(&self) -> &RecordingInfo {
        &self.info
    }

    fn read(&mut self, index: usize) -> Result<Frame, Error> {
        assert!(index != 13, "unlucky");
        self.reads.fetch_add(1, Ordering::SeqCst);
        Ok(Frame::new(index as u64, Timestamp(0), DepthImage::Raw(Image::from_fn(1, 1, |_, _| 1)), None))
    }
}

#[test]
fn reading_ahead_keeps_the_order_and_any_stride() {
    for ahead in [0, 1, 4] {
        let (recording, _) = Counting::new();
        let frames = ReadAhead::new(recording, (20..60).step_by(3), ahead);
        assert_eq!(frames.info().name, "recording");
        let numbers: Vec<usize> = frames.map(|frame| frame.unwrap().index as usize).collect();
        assert_eq!(numbers, (20..60).step_by(3).collect::<Vec<_>>());
    }
}

#[test]
fn reading_ahead_is_bounded_and_ends_when_abandoned() {
    let (recording, reads) = Counting::new();
    let mut frames = ReadAhead::new(recording, 20..usize::MAX, 4);
    for _ in 0..3 {
        assert!(frames.next().unwrap().is_ok());
        // At most what was taken, four in the queue and one in the thread's hands.
    }
    assert!(reads.load(Ordering::SeqCst) <= 3 + 4 + 1);
    // Returns only once the thread has ended, and lets go of the recording.
    drop(frames);
    assert!(reads.load(Ordering::SeqCst) <= 3 + 4 + 1);
    assert_eq!(Arc::strong_count(&reads), 1);
}

#[test]
#[should_panic(expected = "unlucky")]
fn a_panic_while_decoding_is_not_the_end_of_the_recording() {
    let (recording, _) = Counting::new();
    ReadAhead::new(recording, 12..20, 4).for_each(drop);
}

/// A real recording, or `None` where there are none.
fn real(name: &str) -> Option<Box<dyn Recording>> {
    let Some(folder) = std::env::var_os("ITM_TEST_DATA") else {
        println!("skipped, as ITM_TEST_DATA is not set");
        return None;
    };
    Some(recording::open(&Path::new(&folder).join(name), &OpenOptions::default()).unwrap())
}

#[test]
fn the_real_tum_recording_opens() {
    let Some(mut recording) = real("tum_fr1_rpy_head") else { return };
    let info = recording.info().clone();
    assert_eq!((info.format, info.frames, info.depth_without_colour), (Format::Tum, 110, 0));
    assert_eq!(info.calibration.depth, Intrinsics::new(640, 480, 517.3, 516.5, 318.6, 255.3));
    let frame = recording.read(0).unwrap();
    assert_eq!(frame.timestamp, Timestamp(1_305_031_229_528_784_000));
    let truth = info.ground_truth.unwrap();
    assert_eq!(truth.poses()[0].timestamp, Timestamp(1_305_031_225_933_400_000));
    assert_eq!(truth.poses()[0].world_from_camera.translation, DVec3::new(1.3357, 0.6698, 1.6180));
    assert_eq!(frame.depth.size(), (640, 480));
    assert!(frame.world_from_camera.is_some() && frame.colour.is_some());
}

#[test]
fn the_real_icl_nuim_recording_opens() {
    let Some(mut recording) = real("icl_lr_kt2_head") else { return };
    let info = recording.info().clone();
    assert_eq!((info.format, info.frames, info.has_timestamps), (Format::IclNuim, 160, false));
    assert_eq!(info.calibration.depth, Intrinsics::new(640, 480, 481.2, -480.0, 319.5, 239.5));
    assert_eq!(recording.read(0).unwrap().world_from_camera, None);
    let pose = recording.read(2).unwrap().world_from_camera.unwrap();
    assert_eq!(pose.translation, DVec3::new(-0.004_739_52, -0.001_078_61, -2.250_09));
}

#[test]
fn the_real_7_scenes_recording_opens() {
    let Some(mut recording) = real("7scenes_redkitchen_head") else { return };
    let info = recording.info().clone();
    assert_eq!((info.format, info.frames, info.has_timestamps), (Format::SevenScenes, 300, false));
    let frame = recording.read(0).unwrap();
    let pose = frame.world_from_camera.unwrap();
    assert!(pose.translation.abs_diff_eq(DVec3::new(-0.340_456_340, 0.016_469_818, 0.296_569_170), 1e-9));
    assert_eq!(frame.colour.unwrap().size(), (640, 480));
    assert_eq!(info.ground_truth.unwrap().len(), 300);
}
