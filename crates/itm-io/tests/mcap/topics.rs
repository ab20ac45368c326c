//! Which topic is taken for what.

use std::path::{Path, PathBuf};

use glam::DVec3;
use itm_core::Se3;
use tempfile::TempDir;

use crate::files::{FRAMES, INFO, Mcap, START_NS, STEP_NS, pose, transform};
use crate::{error, open, open_with};

fn file(fill: impl FnOnce(&mut Mcap)) -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bag.mcap");
    let mut mcap = Mcap::create(&path);
    fill(&mut mcap);
    mcap.finish();
    (folder, path)
}

fn x_of(path: &Path, topics: &str) -> Option<f64> {
    let pose = open_with(path, topics).unwrap().read(1).unwrap().world_from_camera;
    pose.map(|pose: Se3| pose.translation.x)
}

#[test]
fn several_topics_of_depth_are_listed() {
    let (_folder, path) = file(|mcap| {
        mcap.depth("/front/depth/image_raw", "front").depth("/rear/depth/image_raw", "rear");
        mcap.colour("/front/color/image_raw", "front", 0).colour("/rear/color/image_raw", "rear", 0);
    });
    let message = error(&path);
    let lines: Vec<&str> = message.lines().collect();
    assert!(lines[0].ends_with("bag.mcap': several topics have depth images:"), "{message}");
    assert_eq!(lines[1], "  /front/depth/image_raw: sensor_msgs/msg/Image, 16UC1, 16x12, 5 messages");
    assert_eq!(lines[2], "  /rear/depth/image_raw: sensor_msgs/msg/Image, 16UC1, 16x12, 5 messages");
    assert_eq!(lines[3], "choose with --topics depth=TOPIC");
    // The colour of the same camera goes without saying.
    let recording = open_with(&path, "depth=/rear/depth/image_raw").unwrap();
    assert!(recording.info().has_colour);
    let source = &recording.info().calibration_source;
    assert_eq!(source, "messages of '/rear/depth/camera_info' and '/rear/color/camera_info'");
    let other = "depth=/rear/depth/image_raw, colour=/front/color/image_raw, color_info=/rear/color/camera_info";
    let recording = open_with(&path, other).unwrap();
    assert!(recording.info().calibration_source.ends_with("'/rear/color/camera_info'"));
    assert!(!open_with(&path, "depth=/rear/depth/image_raw,color=none").unwrap().info().has_colour);

    let wrong = open_with(&path, "depth=/rear/color/image_raw").err().unwrap();
    assert!(wrong.contains("the images of '/rear/color/image_raw' are not depth"), "{wrong}");
    let missing = open_with(&path, "depth=/rear/depth").err().unwrap();
    assert!(missing.contains("there is no topic '/rear/depth' for depth"), "{missing}");
    let no_image = open_with(&path, "depth=/rear/depth/camera_info").err().unwrap();
    assert!(no_image.contains("is of sensor_msgs/msg/CameraInfo and cannot be depth"), "{no_image}");
    for bad in ["deep=/a", "depth", "depth=none", "depth=/a,depth=/b", "color="] {
        let message = open_with(&path, bad).err().unwrap();
        assert!(message.contains("is not understood: expected NAME=TOPIC"), "{message}");
    }
}

#[test]
fn raw_images_and_names_that_tell_are_preferred() {
    let (_folder, path) = file(|mcap| {
        mcap.depth("/camera/depth/image_raw", "depth").depth("/camera/infra1/image_raw", "infra");
        mcap.colour("/camera/color/image_raw", "depth", 0).colour("/camera/infra2/image_raw", "infra", 0);
        let nothing = crate::files::compressed(START_NS, "depth", "16UC1; compressedDepth rvl", &[0; 12]);
        mcap.put("/camera/depth/image_raw/compressedDepth", "sensor_msgs/CompressedImage", START_NS, &nothing);
    });
    let recording = open(&path);
    assert_eq!(
        recording.info().calibration_source,
        "messages of '/camera/depth/camera_info' and '/camera/color/camera_info'"
    );
    assert_eq!(recording.info().frames, FRAMES);
}

#[test]
fn without_depth_it_is_said_what_there_is() {
    let (_folder, path) = file(|mcap| {
        mcap.colour("/color/image_raw", "camera", 0);
        mcap.put_as("/chatter", "std_msgs/msg/String", "cdr", START_NS, b"");
    });
    let message = error(&path);
    assert!(message.contains("it has no depth images; its topics are:\n"), "{message}");
    assert!(message.contains("\n  /color/image_raw: sensor_msgs/msg/Image, 5 messages\n"), "{message}");
    assert!(message.contains("\n  /chatter: std_msgs/msg/String (encoding 'cdr'), 1 messages\n"), "{message}");

    let (_folder, path) = file(|mcap| {
        mcap.put_as("/depth/image_raw", "sensor_msgs/Image", "ros1", START_NS, b"");
    });
    let message = error(&path);
    assert!(message.contains("its messages are those of ROS 1 (encoding ros1), which are not read"), "{message}");
}

#[test]
fn a_calibration_is_found_beside_the_images_or_by_its_frame() {
    let put_info = |mcap: &mut Mcap, topic: &str, frame: &str| {
        mcap.put(topic, "sensor_msgs/CameraInfo", START_NS, &INFO.message(frame, false));
    };
    let (_folder, path) = file(|mcap| {
        mcap.depth("/camera/depth", "optical");
        put_info(mcap, "/infos/a", "elsewhere");
        put_info(mcap, "/infos/b", "/optical");
    });
    // Beside the images there is one.
    assert_eq!(open(&path).info().calibration_source, "messages of '/camera/camera_info'");
    let (_folder, path) = file(|mcap| {
        let image = crate::files::image(START_NS, "optical", "mono16", false, 0, &[1; 16 * 12 * 2]);
        mcap.put("/camera/depth/image", "sensor_msgs/Image", START_NS, &image);
        put_info(mcap, "/infos/a", "elsewhere");
        put_info(mcap, "/infos/b", "/optical");
    });
    assert_eq!(open(&path).info().calibration_source, "messages of '/infos/b'");
    let (_folder, path) = file(|mcap| {
        let image = crate::files::image(START_NS, "optical", "mono16", false, 0, &[1; 16 * 12 * 2]);
        mcap.put("/camera/depth/image", "sensor_msgs/Image", START_NS, &image);
        put_info(mcap, "/infos/a", "elsewhere");
    });
    let message = error(&path);
    assert!(message.contains("the calibration of the camera of '/camera/depth/image' (frame 'optical')"), "{message}");
    assert!(message.contains("\n  /infos/a: sensor_msgs/msg/CameraInfo, 1 messages\n"), "{message}");
    assert!(message.contains("choose with --topics depth_info=TOPIC"), "{message}");
    assert!(open_with(&path, "depth_info=/infos/a").is_ok());
}

#[test]
fn images_pair_by_their_stamps() {
    let near = |delay_ns| {
        let (_folder, path) = file(|mcap| {
            mcap.depth("/depth/image", "camera").colour("/color/image", "camera", delay_ns);
        });
        open_with(&path, "").map(|recording| (recording.info().frames, recording.info().depth_without_colour))
    };
    assert_eq!(near(10_000_000), Ok((FRAMES, 0)));
    assert_eq!(near(-10_000_000), Ok((FRAMES, 0)));
    // Nearer to the next depth image: the first one has none.
    assert_eq!(near(28_000_000), Ok((FRAMES - 1, 1)));
    let far = near(10_000_000_000).unwrap_err();
    assert!(far.contains("none of the 5 depth images of '/depth/image' was taken within 20.0 ms"), "{far}");
}

#[test]
fn poses_come_from_a_topic_or_from_the_tree() {
    let time = |number: usize| START_NS + number as i64 * STEP_NS;
    let (_folder, path) = file(|mcap| {
        mcap.depth("/depth/image", "optical");
        for number in 0..FRAMES {
            let x = number as f64;
            mcap.put("/tf", "tf2_msgs/TFMessage", time(number), &transform(time(number), "odom", "base", x));
            mcap.put("/mocap/camera", "geometry_msgs/PoseStamped", time(number), &pose(time(number), 10.0 + x));
            mcap.put("/estimate", "geometry_msgs/PoseStamped", time(number), &pose(time(number), 20.0 + x));
        }
        mcap.put("/tf_static", "tf2_msgs/TFMessage", START_NS, &transform(START_NS, "base", "optical", 0.5));
        mcap.put("/tf_static", "tf2_msgs/TFMessage", START_NS, &transform(START_NS, "map", "odom", 100.0));
    });
    assert_eq!(x_of(&path, ""), Some(11.0), "a name says that it is the truth");
    assert_eq!(x_of(&path, "pose=/estimate"), Some(21.0));
    assert_eq!(x_of(&path, "pose=/tf"), Some(101.5));
    assert_eq!(x_of(&path, "pose=none"), None);
    let truth = open_with(&path, "pose=/tf").unwrap().info().ground_truth.clone().unwrap();
    assert_eq!(truth.len(), FRAMES);

    let (_folder, path) = file(|mcap| {
        mcap.depth("/depth/image", "optical").put("/a", "geometry_msgs/PoseStamped", START_NS, &pose(START_NS, 1.0));
        mcap.put("/b", "geometry_msgs/PoseStamped", START_NS, &pose(START_NS, 2.0));
    });
    assert!(open(&path).info().ground_truth.is_none(), "which one is true is not known");
}

#[test]
fn depth_and_colour_lie_to_each_other_as_the_tree_says() {
    let extrinsics = |tree: bool| {
        let (_folder, path) = file(|mcap| {
            mcap.depth("/depth/image", "depth").colour("/color/image", "/color", 0);
            if tree {
                mcap.put("/tf_static", "tf2_msgs/TFMessage", 0, &transform(0, "link", "depth", 0.5));
                mcap.put("/tf_static", "tf2_msgs/TFMessage", 0, &transform(0, "link", "color", 0.75));
            }
        });
        open(&path).info().calibration.colour_from_depth
    };
    assert!(extrinsics(true).translation.abs_diff_eq(DVec3::new(-0.25, 0.0, 0.0), 1e-15));
    assert_eq!(extrinsics(false), Se3::IDENTITY);
}

#[test]
fn stamps_that_nobody_set_give_way_to_times_of_recording() {
    let (_folder, path) = file(|mcap| {
        mcap.put("/camera_info", "sensor_msgs/CameraInfo", START_NS, &INFO.message("camera", false));
        for number in 0..3 {
            let image = crate::files::image(0, "camera", "16UC1", false, 0, &[1; 16 * 12 * 2]);
            mcap.put("/depth", "sensor_msgs/Image", START_NS + number * STEP_NS, &image);
        }
    });
    assert_eq!(open(&path).read(2).unwrap().timestamp.0, START_NS + 2 * STEP_NS);
}
