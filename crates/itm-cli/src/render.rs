//! `itm render`.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, anyhow, bail};
use clap::{Args, ValueEnum};
use glam::{DQuat, DVec3};
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder as _};
use itm_core::{Image, Intrinsics, Se3, Settings, Trajectory};
use itm_io::mesh::UpAxis;
use itm_slam::{BlockSource, ColourImage, MapViews, SavedMap, Scale, Shading, Slam, full_confidence};
use serde_json::json;

use crate::{console, maps, pictures, synth};

/// Blocks that stay on the device between pictures.
const MAX_BLOCKS: u32 = 65_536;

/// Render a saved map from any pose: shape, colours, normals, depth or confidence
///
/// Pictures are PNG files; what shows nothing is transparent. Depth and confidence are on a scale of colours, from dark blue
/// (near; hardly known) to yellow (at --max-depth; known as well as the map's settings allow). With depth comes a second
/// file, NAME-mm.png: 16-bit millimetres, 0 where there is none.
///
/// With --points, what each pose sees is written as a point cloud in the map's world: positions, normals, weights, and
/// colours and confidences where the map has them.
///
/// Only blocks in view go to the device. A map of several submaps is shown as one: their signed distances' mean by weight.
#[derive(Args)]
#[command(after_help = "\
Examples:
  itm render room.itm -o views --every 10            along the map's own trajectory, a file a pose
  itm render room.itm -o front.png --pose=0,0,-1,0,0,0,1 --kind colour --size 1280x720 --fov 70 --max-depth 6
  itm render room.itm -o views --trajectory other.txt --kind depth --camera calibration.txt
  itm render room.itm -o seen.ply --points --pose=0,0,-1,0,0,0,1")]
pub(crate) struct Arguments {
    /// The map file
    map: PathBuf,
    /// File to write: .png, or with --points .ply, .pcd or .xyz; without --pose the folder for a file a pose, made where it is
    /// missing
    #[arg(short, long)]
    out: PathBuf,
    /// The camera's position in metres and its rotation as a unit quaternion, camera to world
    #[arg(long, value_name = "TX,TY,TZ,QX,QY,QZ,QW", value_parser = parse_pose, allow_hyphen_values = true)]
    #[arg(conflicts_with_all = ["trajectory", "every"])]
    pose: Option<Se3>,
    /// Poses to render from, TUM format [default: the map's own]
    #[arg(long, value_name = "FILE")]
    trajectory: Option<PathBuf>,
    /// Only every N-th pose
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    every: u32,
    /// What to show
    #[arg(long, value_enum, default_value_t = Kind::Grey)]
    kind: Kind,
    /// Write the surface that each pose sees as a point cloud
    #[arg(long, conflicts_with = "kind")]
    points: bool,
    /// Width and height in pixels [default: the camera's; 640x480 with --fov]
    #[arg(long, value_parser = synth::parse_size)]
    size: Option<(u32, u32)>,
    /// A camera with this field of view along the image's width, in degrees, in place of the map's depth camera
    #[arg(long, value_name = "DEGREES", value_parser = parse_fov, conflicts_with = "camera")]
    fov: Option<f64>,
    /// A calibration file, whose depth camera is taken
    #[arg(long, value_name = "FILE")]
    camera: Option<PathBuf>,
    /// How far to see, in metres [default: as far as the map's settings say]
    #[arg(long, value_name = "METRES", value_parser = parse_depth)]
    max_depth: Option<f32>,
    /// Show this submap alone, in its own frame [default: all of them as one, in the world's]
    #[arg(long, value_name = "NUMBER")]
    submap: Option<u16>,
    /// Keep so much of the map in memory; the rest goes to a temporary file
    #[arg(long, value_name = "MIB", default_value_t = 1024)]
    memory: u64,
    /// Adapter: auto, a number from 'itm devices' or a part of its name [default: that of the map's settings]
    #[arg(long)]
    device: Option<String>,
    /// Print what was written as JSON
    #[arg(long)]
    json: bool,
    /// Show no progress and print nothing
    #[arg(short, long)]
    quiet: bool,
}

/// What a picture shows.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Kind {
    /// Shape, lit from the camera
    Grey,
    /// The same with highlights
    Phong,
    /// The map's colours
    #[value(alias = "color")]
    Colour,
    /// Normals: red, green, blue for the world's x, y, z
    Normals,
    /// Depth along the optical axis
    Depth,
    /// How well the surface is known
    Confidence,
}

impl Kind {
    pub(crate) fn shading(self) -> Shading {
        match self {
            Self::Grey => Shading::Grey,
            Self::Phong => Shading::Phong,
            Self::Colour => Shading::Colour,
            Self::Normals => Shading::Normals,
            Self::Depth => Shading::Depth,
            Self::Confidence => Shading::Confidence,
        }
    }
}

pub(crate) fn run(arguments: &Arguments) -> Result<u8> {
    arguments.check_out()?;
    let given = arguments.camera.as_deref().map(itm_io::calibration::read).transpose()?.map(|c| c.depth);
    let poses = arguments.trajectory.as_deref().map(itm_io::trajectory::read_tum).transpose()?;
    if let Some(slam) = maps::of_surfels(&arguments.map, arguments.device.as_deref())? {
        return arguments.draw_surfels(slam, given, poses.as_ref());
    }
    let mut map = maps::open(&arguments.map, arguments.memory, arguments.quiet)?;
    if arguments.kind == Kind::Colour && !map.header().voxel_kind.colour {
        bail!("the map '{}' has no colours; try --kind grey", arguments.map.display());
    }
    if let Some(submap) = arguments.submap {
        maps::check_submap(&map, submap)?;
    }
    let camera = arguments.camera(given.unwrap_or(map.header().calibration.depth));
    let poses = arguments.poses(poses.as_ref().unwrap_or(map.trajectory()))?;
    let settings = settings_of(&map);
    let max_depth_m = arguments.max_depth.unwrap_or(settings.view.max_depth_m + settings.map.truncation_m);
    let scale = Scale { depth_m: [0.0, max_depth_m], confidence: full_confidence(&settings) };
    arguments.make_folder()?;
    let device = maps::device(arguments.device.as_deref(), &map)?;
    // The combined map is one submap, with number 0.
    let mut views = MapViews::new(&device, map.layout(), arguments.submap.unwrap_or(0), MAX_BLOCKS)?;
    let mut combined;
    let source: &mut dyn BlockSource = match arguments.submap {
        None => {
            combined = map.combined()?;
            &mut combined
        }
        Some(_) => &mut map,
    };
    let bar = console::bar(poses.len() as u64, "views", arguments.quiet);
    let (mut files, mut points) = (Vec::new(), 0);
    for (i, pose) in poses.iter().enumerate() {
        let extension = if arguments.points { "ply" } else { "png" };
        let path = arguments.file(i, extension);
        views.look(source, &camera, pose, max_depth_m)?;
        if arguments.points {
            let seen = views.points()?;
            points += seen.positions.len();
            itm_io::points::write(&path, &seen, UpAxis::default())?;
        } else {
            arguments.draw(&views, &scale, &path)?;
        }
        files.push(path);
        bar.inc(1);
    }
    bar.finish_and_clear();
    arguments.tell(&files, points, &camera)?;
    Ok(0)
}

impl Arguments {
    /// The poses to render from.
    fn poses(&self, trajectory: &Trajectory) -> Result<Vec<Se3>> {
        let along = trajectory.poses().iter().step_by(self.every as usize).map(|pose| pose.world_from_camera);
        let poses: Vec<Se3> = self.pose.map_or_else(|| along.collect(), |pose| vec![pose]);
        if poses.is_empty() {
            bail!("there is no pose to render from; give one with --pose");
        }
        Ok(poses)
    }

    /// The file of a pose.
    fn file(&self, index: usize, extension: &str) -> PathBuf {
        match self.pose {
            Some(_) => self.out.clone(),
            None => self.out.join(format!("{:06}.{extension}", index * self.every as usize)),
        }
    }

    fn make_folder(&self) -> Result<()> {
        if self.pose.is_none() {
            let shown = self.out.display();
            fs::create_dir_all(&self.out).with_context(|| format!("cannot make the output folder '{shown}'"))?;
        }
        Ok(())
    }

    /// Renders a map of surfels.
    fn draw_surfels(&self, mut slam: Slam, given: Option<Intrinsics>, poses: Option<&Trajectory>) -> Result<u8> {
        if self.submap.is_some() {
            bail!("--submap is for maps of voxels; of '{}' all submaps are shown", self.map.display());
        }
        let camera = self.camera(given.unwrap_or(slam.calibration().depth));
        let poses = self.poses(poses.unwrap_or(slam.trajectory()))?;
        let max_depth_m = self.max_depth.unwrap_or(slam.settings().view.max_depth_m);
        self.make_folder()?;
        let bar = console::bar(poses.len() as u64, "views", self.quiet);
        let (mut files, mut points) = (Vec::new(), 0);
        for (i, pose) in poses.iter().enumerate() {
            let path = self.file(i, if self.points { "ply" } else { "png" });
            let seen = slam.seen_surfels(&camera, pose, max_depth_m)?;
            if self.points {
                points += seen.points.positions.len();
                itm_io::points::write(&path, &seen.points, UpAxis::default())?;
            } else {
                let picture = slam.render(&camera, pose, max_depth_m, self.kind.shading())?;
                self.write_picture(&path, &picture, || Ok(seen.depth_millimetres))?;
            }
            files.push(path);
            bar.inc(1);
        }
        bar.finish_and_clear();
        self.tell(&files, points, &camera)?;
        Ok(0)
    }

    /// Prints what was written.
    fn tell(&self, files: &[PathBuf], points: usize, camera: &Intrinsics) -> Result<()> {
        let (count, size) = (files.len(), (camera.width, camera.height));
        if self.json {
            let mut answer = json!({ "files": files, "width": size.0, "height": size.1 });
            if self.points {
                answer["points"] = points.into();
            }
            console::print_json(&answer)?;
        } else if !self.quiet {
            let shown = self.out.display();
            let what = match (self.points, count) {
                (true, 1) => format!("{points} points"),
                (true, _) => format!("{count} clouds, {points} points in all"),
                (false, 1) => "1 picture".into(),
                (false, _) => format!("{count} pictures"),
            };
            console::print(format_args!("{shown}: {what} of {}x{} pixels", size.0, size.1))?;
        }
        Ok(())
    }

    /// Writes a picture of the view, with depth its millimetres as well.
    fn draw(&self, views: &MapViews, scale: &Scale, path: &Path) -> Result<()> {
        let picture = views.picture(self.kind.shading(), scale)?;
        self.write_picture(path, &picture, || Ok(views.depth_millimetres()?))
    }

    fn write_picture(
        &self,
        path: &Path,
        picture: &ColourImage,
        depth_millimetres: impl FnOnce() -> Result<Image<u16>>,
    ) -> Result<()> {
        write(path, pictures::encode(picture.size(), picture.data().as_flattened()))?;
        if self.kind == Kind::Depth {
            let name = format!("{}-mm.png", path.file_stem().unwrap_or_default().to_string_lossy());
            write(&path.with_file_name(name), encode_depth(&depth_millimetres()?))?;
        }
        Ok(())
    }

    /// Whether the output is what the poses ask for.
    fn check_out(&self) -> Result<()> {
        let shown = self.out.display();
        if self.pose.is_none() {
            if self.out.exists() && !self.out.is_dir() {
                bail!("the output '{shown}' is a file; name a folder for a file a pose, or give one pose with --pose");
            }
            return Ok(());
        }
        if self.points {
            itm_io::points::check_name(&self.out)?;
            return maps::check_folder_of(&self.out);
        }
        let extension = self.out.extension().unwrap_or_default().to_string_lossy().to_lowercase();
        if extension != "png" {
            bail!("cannot tell the picture format of '{shown}' from its name: expected it to end in .png");
        }
        maps::check_folder_of(&self.out)
    }

    /// The camera to render with, where nothing is said the one given.
    fn camera(&self, camera: Intrinsics) -> Intrinsics {
        match self.fov {
            None => self.size.map_or(camera, |(width, height)| camera.scaled_to(width, height)),
            Some(degrees) => {
                let (width, height) = self.size.unwrap_or((640, 480));
                let middle = |pixels: u32| 0.5 * f64::from(pixels) - 0.5;
                let focal = 0.5 * f64::from(width) / (0.5 * degrees.to_radians()).tan();
                Intrinsics::new(width, height, focal, focal, middle(width), middle(height))
            }
        }
    }
}

/// The settings of the run that made the map; the defaults where they are not known any more.
fn settings_of(map: &SavedMap) -> Settings {
    map.settings().unwrap_or_else(|error| {
        tracing::warn!("the map's settings are not all known, so the defaults hold: {error}");
        Settings::default()
    })
}

fn write(path: &Path, png: Result<Vec<u8>, String>) -> Result<()> {
    let failed = || format!("cannot write '{}'", path.display());
    let png = png.map_err(|reason| anyhow!(reason)).with_context(failed)?;
    fs::write(path, png).with_context(failed)
}

/// A 16-bit PNG file.
fn encode_depth(depth: &Image<u16>) -> Result<Vec<u8>, String> {
    let mut png = Vec::new();
    // The encoder takes the machine's byte order.
    let bytes: Vec<u8> = depth.data().iter().flat_map(|v| v.to_ne_bytes()).collect();
    let encoder = PngEncoder::new(&mut png);
    let written = encoder.write_image(&bytes, depth.width(), depth.height(), ExtendedColorType::L16);
    written.map_err(|error| error.to_string())?;
    Ok(png)
}

fn parse_pose(text: &str) -> Result<Se3> {
    let [tx, ty, tz, qx, qy, qz, qw] = maps::numbers(text)?;
    Ok(Se3::try_from_quaternion(DQuat::from_xyzw(qx, qy, qz, qw), DVec3::new(tx, ty, tz))?)
}

fn parse_fov(text: &str) -> Result<f64, String> {
    let degrees = text.parse::<f64>().ok().filter(|degrees| (1.0..=170.0).contains(degrees));
    degrees.ok_or_else(|| format!("expected degrees between 1 and 170, not '{text}'"))
}

fn parse_depth(text: &str) -> Result<f32, String> {
    let metres = text.parse::<f32>().ok().filter(|metres| *metres > 0.0 && *metres <= 1000.0);
    metres.ok_or_else(|| format!("expected metres above 0 and at most 1000, not '{text}'"))
}
