//! A recording as a folder of files.

use std::convert::Infallible;
use std::fmt::Write as _;
use std::fs;
use std::io::{BufWriter, Write as _};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};
use itm_core::{ColourImage, DepthImage, Frame, Image};
use rayon::prelude::*;

use crate::{Error, Sequence};

/// Steps of the written depth for a metre.
const DEPTH_STEPS_PER_M: f32 = 5000.0;

/// What was written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Written {
    /// The folder.
    pub folder: PathBuf,
    /// Number of frames.
    pub frames: u32,
    /// The calibration file within the folder.
    pub calibration: PathBuf,
    /// The file with the exact poses within the folder.
    pub ground_truth: PathBuf,
}

/// Writes a recording into a folder in the format of the TUM RGB-D benchmark (Sturm et al. 2012).
///
/// - `rgb/`, `depth/`: PNG images; depth has 16 bits and 5000 steps for a metre, 0 where nothing is seen (and beyond
///   13.1 m, which 16 bits cannot say).
/// - `rgb.txt`, `depth.txt`: time stamp in seconds and file of each image; `associations.txt`: both, colour first. A
///   sequence without colour has `depth.txt` alone.
/// - `groundtruth.txt`: `timestamp tx ty tz qx qy qz qw`, the exact pose of each frame, camera to world.
/// - `gyroscope.txt`, `accelerometer.txt`: `timestamp x y z` in the camera's axes, in rad/s and m/s².
/// - `calibration.txt`: in InfiniTAM's format: size, focal lengths and principal point of colour and depth camera,
///   motion from depth to colour, meaning of depth.
///
/// The folder is made where it is missing; files of the same names are replaced. The lists are written last, so that a
/// recording that was broken off has none. Files do not depend on the number of threads. `progress` is called after
/// each frame, from any thread, with the number of frames written so far.
///
/// # Errors
/// Where a file cannot be written.
pub fn write_recording(folder: &Path, sequence: &Sequence, progress: &(dyn Fn(u32) + Sync)) -> Result<Written, Error> {
    let told = |done| {
        progress(done);
        ControlFlow::<Infallible>::Continue(())
    };
    match write_all(folder, sequence, &told)? {
        ControlFlow::Continue(written) => Ok(written),
        ControlFlow::Break(never) => match never {},
    }
}

/// The same, broken off after the frames under way where `progress` says so; `None` then.
///
/// # Errors
/// As [`write_recording`].
pub fn write_recording_until(
    folder: &Path,
    sequence: &Sequence,
    progress: &(dyn Fn(u32) -> ControlFlow<()> + Sync),
) -> Result<Option<Written>, Error> {
    Ok(write_all(folder, sequence, progress)?.continue_value())
}

fn write_all<B: Send>(
    folder: &Path,
    sequence: &Sequence,
    progress: &(dyn Fn(u32) -> ControlFlow<B> + Sync),
) -> Result<ControlFlow<B, Written>, Error> {
    for sub in ["rgb", "depth"] {
        let path = folder.join(sub);
        fs::create_dir_all(&path).map_err(|source| Error::Write { path, source })?;
    }
    let frames = sequence.spec().frames;
    let done = AtomicU32::new(0);
    let written = (0..frames).into_par_iter().try_for_each(|i| {
        write_frame(folder, &sequence.frame(i)).map_err(ControlFlow::Continue)?;
        match progress(done.fetch_add(1, Ordering::Relaxed) + 1) {
            ControlFlow::Continue(()) => Ok(()),
            ControlFlow::Break(broken) => Err(ControlFlow::Break(broken)),
        }
    });
    match written {
        Ok(()) => {}
        Err(ControlFlow::Break(broken)) => return Ok(ControlFlow::Break(broken)),
        Err(ControlFlow::Continue(error)) => return Err(error),
    }

    let calibration = folder.join("calibration.txt");
    write_text(&calibration, &calibration_text(sequence))?;
    write_inertial(folder, sequence)?;
    let ground_truth = folder.join("groundtruth.txt");
    write_text(&ground_truth, &poses_text(sequence))?;
    write_lists(folder, sequence)?;
    tracing::debug!(folder = %folder.display(), frames, "recording written");
    Ok(ControlFlow::Continue(Written { folder: folder.to_path_buf(), frames, calibration, ground_truth }))
}

fn image_name(kind: &str, index: u64) -> String {
    format!("{kind}/{index:06}.png")
}

fn write_frame(folder: &Path, frame: &Frame) -> Result<(), Error> {
    if let Some(colour) = &frame.colour {
        write_colour(&folder.join(image_name("rgb", frame.index)), colour)?;
    }
    let raw = match &frame.depth {
        DepthImage::Raw(raw) => raw.clone(),
        DepthImage::Metres(metres) => quantise(metres),
    };
    write_depth(&folder.join(image_name("depth", frame.index)), &raw)
}

/// Depth in steps; 0 where there is none or it does not fit. 65535 is left out, as it means 'no measurement' to some.
fn quantise(metres: &Image<f32>) -> Image<u16> {
    Image::from_fn(metres.width(), metres.height(), |x, y| {
        let steps = (metres[(x, y)] * DEPTH_STEPS_PER_M).round();
        if (1.0..65535.0).contains(&steps) { steps as u16 } else { 0 }
    })
}

fn write_colour(path: &Path, colour: &ColourImage) -> Result<(), Error> {
    let rgb: Vec<u8> = colour.data().iter().flat_map(|[r, g, b, _]| [*r, *g, *b]).collect();
    write_png(path, &rgb, colour.size(), ExtendedColorType::Rgb8)
}

fn write_depth(path: &Path, raw: &Image<u16>) -> Result<(), Error> {
    // The encoder takes 16-bit values in the machine's byte order.
    let bytes: Vec<u8> = raw.data().iter().flat_map(|v| v.to_ne_bytes()).collect();
    write_png(path, &bytes, raw.size(), ExtendedColorType::L16)
}

fn write_png(path: &Path, bytes: &[u8], (width, height): (u32, u32), kind: ExtendedColorType) -> Result<(), Error> {
    let failed = |source| Error::Write { path: path.to_path_buf(), source };
    let mut file = BufWriter::new(fs::File::create(path).map_err(failed)?);
    PngEncoder::new_with_quality(&mut file, CompressionType::Fast, FilterType::Adaptive)
        .write_image(bytes, width, height, kind)
        .map_err(|source| Error::WriteImage { path: path.to_path_buf(), source })?;
    file.flush().map_err(failed)
}

fn write_text(path: &Path, text: &str) -> Result<(), Error> {
    fs::write(path, text).map_err(|source| Error::Write { path: path.to_path_buf(), source })
}

fn write_lists(folder: &Path, sequence: &Sequence) -> Result<(), Error> {
    let mut associations = String::new();
    let mut rgb = String::from("# colour images\n# timestamp filename\n");
    let mut depth = String::from("# depth maps\n# timestamp filename\n");
    for i in 0..sequence.spec().frames {
        let (time, colour_time) = (sequence.timestamp(i), sequence.colour_timestamp(i));
        let (of_rgb, of_depth) = (image_name("rgb", i.into()), image_name("depth", i.into()));
        // Writing to a string cannot fail.
        let _ = writeln!(rgb, "{colour_time} {of_rgb}");
        let _ = writeln!(depth, "{time} {of_depth}");
        let _ = writeln!(associations, "{colour_time} {of_rgb} {time} {of_depth}");
    }
    write_text(&folder.join("depth.txt"), &depth)?;
    if !sequence.spec().colour {
        return Ok(());
    }
    write_text(&folder.join("rgb.txt"), &rgb)?;
    write_text(&folder.join("associations.txt"), &associations)
}

fn poses_text(sequence: &Sequence) -> String {
    let mut text = String::from("# exact poses, camera to world (y down)\n# timestamp tx ty tz qx qy qz qw\n");
    for pose in sequence.trajectory().poses() {
        let (t, q) = (pose.world_from_camera.translation, pose.world_from_camera.rotation);
        let _ = writeln!(text, "{} {} {} {} {} {} {} {}", pose.timestamp, t.x, t.y, t.z, q.x, q.y, q.z, q.w);
    }
    text
}

fn write_inertial(folder: &Path, sequence: &Sequence) -> Result<(), Error> {
    let mut gyroscope = String::from(
        "# angular velocity in the camera's axes (x right, y down, z forward), rad/s\n# timestamp wx wy wz\n",
    );
    let mut accelerometer = String::from(
        "# acceleration less gravity in the camera's axes (x right, y down, z forward), m/s^2\n# timestamp ax ay az\n",
    );
    for reading in sequence.inertial() {
        let (time, w, a) = (reading.timestamp, reading.gyroscope, reading.accelerometer);
        let _ = writeln!(gyroscope, "{time} {:.9} {:.9} {:.9}", w.x, w.y, w.z);
        let _ = writeln!(accelerometer, "{time} {:.9} {:.9} {:.9}", a.x, a.y, a.z);
    }
    write_text(&folder.join("gyroscope.txt"), &gyroscope)?;
    write_text(&folder.join("accelerometer.txt"), &accelerometer)
}

fn calibration_text(sequence: &Sequence) -> String {
    let c = sequence.spec().camera;
    let camera = format!("{} {}\n{} {}\n{} {}\n", c.width, c.height, c.fx, c.fy, c.cx, c.cy);
    let step_m = 1.0 / f64::from(DEPTH_STEPS_PER_M);
    format!("{camera}\n{camera}\n1 0 0 0\n0 1 0 0\n0 0 1 0\n\naffine {step_m} 0\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{DepthNoise, Path as CameraPath, Spec};

    fn written(spec: Spec, threads: usize) -> (tempfile::TempDir, Written) {
        let folder = tempfile::tempdir().unwrap();
        let sequence = Sequence::new(spec).unwrap();
        let calls = AtomicU32::new(0);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let result = pool.install(|| {
            write_recording(folder.path(), &sequence, &|_| {
                calls.fetch_add(1, Ordering::Relaxed);
            })
        });
        assert_eq!(calls.into_inner(), spec.frames);
        (folder, result.unwrap())
    }

    fn files(folder: &Path) -> Vec<(String, Vec<u8>)> {
        let mut all = Vec::new();
        for sub in ["", "rgb", "depth"] {
            for entry in fs::read_dir(folder.join(sub)).unwrap().map(Result::unwrap) {
                if entry.file_type().unwrap().is_file() {
                    let name = format!("{sub}/{}", entry.file_name().to_str().unwrap());
                    all.push((name, fs::read(entry.path()).unwrap()));
                }
            }
        }
        all.sort();
        all
    }

    #[test]
    fn the_same_seed_gives_the_same_bytes_on_any_number_of_threads() {
        let spec = Spec::new(CameraPath::Arc).with_size(40, 30).with_frames(3).with_noise(DepthNoise::KINECT, 4);
        let ((a, _), (b, _)) = (written(spec, 1), written(spec, 3));
        let (a, b) = (files(a.path()), files(b.path()));
        assert_eq!(a.len(), 7 + 2 * 3);
        assert!(a == b, "the two recordings differ");
        let (other, _) = written(Spec { seed: 5, ..spec }, 2);
        assert_ne!(files(other.path()), b);
    }

    #[test]
    fn what_is_written_is_what_was_rendered() {
        let spec = Spec::new(CameraPath::Loop).with_size(40, 30).with_frames(2);
        let (folder, written) = written(spec, 2);
        let sequence = Sequence::new(spec).unwrap();
        let frame = sequence.frame(1);
        let DepthImage::Metres(metres) = &frame.depth else { panic!("metres") };
        let depth = image::open(folder.path().join("depth/000001.png")).unwrap().into_luma16();
        let rgb = image::open(folder.path().join("rgb/000001.png")).unwrap().into_rgb8();
        for (x, y, raw) in depth.enumerate_pixels() {
            assert!((f32::from(raw[0]) / 5000.0 - metres[(x, y)]).abs() <= 0.00011);
            assert_eq!(rgb.get_pixel(x, y).0, frame.colour.as_ref().unwrap()[(x, y)][..3]);
        }
        let poses = fs::read_to_string(&written.ground_truth).unwrap();
        let row = poses.lines().nth(3).unwrap();
        let numbers: Vec<f64> = row.split(' ').map(|n| n.parse().unwrap()).collect();
        assert!(row.starts_with("1.033333333 "), "{row}");
        let pose = sequence.world_from_camera(1);
        assert_eq!(&numbers[1..4], pose.translation.to_array());
        assert_eq!(&numbers[4..], pose.rotation.to_array());
        let list = fs::read_to_string(folder.path().join("associations.txt")).unwrap();
        assert_eq!(list.lines().nth(1).unwrap(), "1.033333333 rgb/000001.png 1.033333333 depth/000001.png");
    }

    #[test]
    fn lists_have_the_time_of_delayed_colour() {
        let spec = Spec { colour_delay_s: 0.012, ..Spec::new(CameraPath::Arc).with_size(8, 6).with_frames(2) };
        let (folder, _) = written(spec, 1);
        let last = |name: &str| {
            let text = fs::read_to_string(folder.path().join(name)).unwrap();
            text.lines().last().unwrap().to_string()
        };
        assert_eq!(last("associations.txt"), "1.045333333 rgb/000001.png 1.033333333 depth/000001.png");
        assert_eq!(last("rgb.txt"), "1.045333333 rgb/000001.png");
        assert_eq!(last("depth.txt"), "1.033333333 depth/000001.png");
    }

    #[test]
    fn a_recording_without_colour_lists_none() {
        let spec = Spec { colour: false, ..Spec::new(CameraPath::Arc).with_size(8, 6).with_frames(2) };
        let (folder, _) = written(spec, 1);
        assert!(folder.path().join("depth.txt").exists());
        assert!(!folder.path().join("rgb.txt").exists() && !folder.path().join("associations.txt").exists());
    }

    #[test]
    fn the_calibration_file_has_the_reports_layout() {
        let sequence = Sequence::new(Spec::new(CameraPath::Arc)).unwrap();
        let camera = "640 480\n525 525\n319.5 239.5\n";
        let expected = format!("{camera}\n{camera}\n1 0 0 0\n0 1 0 0\n0 0 1 0\n\naffine 0.0002 0\n");
        assert_eq!(calibration_text(&sequence), expected);
    }

    #[test]
    fn depth_that_does_not_fit_is_no_measurement() {
        let metres = Image::new(5, 1, vec![0.0, 13.106, 13.108, 50.0, f32::NAN]).unwrap();
        assert_eq!(quantise(&metres).data(), [0, 65530, 0, 0, 0]);
    }

    #[test]
    fn a_folder_that_cannot_be_made_is_named() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let sequence = Sequence::new(Spec::new(CameraPath::Arc).with_size(4, 3).with_frames(1)).unwrap();
        let error = write_recording(&file.path().join("in"), &sequence, &|_| ()).unwrap_err();
        assert!(matches!(&error, Error::Write { path, .. } if path.starts_with(file.path())), "{error}");
    }
}
