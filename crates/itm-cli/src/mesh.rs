//! `itm mesh`.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Result, bail};
use clap::Args;
use glam::{DVec3, Vec3};
use itm_core::surfel::{Surfel, cloud_of_surfels};
use itm_core::{Mesh, PointCloud};
use itm_io::mesh::{self as mesh_file, UpAxis};
use itm_io::points as point_file;
use itm_slam::{MeshOptions, Slam, decimate};
use serde_json::json;

use crate::console;
use crate::maps::{self, MIB};
use crate::results::UpArgument;

/// Mesh a saved map
///
/// The map is meshed part by part, so that the device needs room for a part only, and the host for the mesh and --memory.
/// A map of several submaps is meshed as one: their signed distances' mean by weight, in the world's frame. With a name that
/// ends in .itm, --fuse-submaps writes that as a map file of one submap.
///
/// Where several are asked for, --crop comes first, then --components, then --decimate.
#[derive(Args)]
#[command(after_help = "\
Examples:
  itm mesh room.itm -o room.ply
  itm mesh room.itm -o room.glb --components 1000 --decimate 0.1
  itm mesh room.itm -o table.obj --crop=-0.5,-0.2,0.8,0.7,0.6,1.9 --min-weight 3
  itm mesh room.itm -o room.pcd --points --up z-up
  itm mesh building.itm -o storey.ply --submap 2
  itm mesh building.itm -o one.itm --fuse-submaps")]
pub(crate) struct Arguments {
    /// The map file
    map: PathBuf,
    /// File to write: .ply, .obj, .stl or .glb; with --points .ply, .pcd or .xyz; with --fuse-submaps .itm as well
    #[arg(short, long)]
    out: PathBuf,
    /// Mesh this submap alone, in its own frame
    #[arg(long, value_name = "NUMBER")]
    submap: Option<u16>,
    /// Mesh all submaps as one, as without this; a file that ends in .itm becomes a map of one submap
    #[arg(long, conflicts_with = "submap")]
    fuse_submaps: bool,
    /// Only where voxels have been observed so often [default: 1]; of points of surfels those of at least this confidence, 0 for all
    /// [default: surfels.stable]
    #[arg(long, value_name = "N")]
    min_weight: Option<u32>,
    /// Only what lies in this box, in metres of the map's world
    #[arg(long, value_name = "X0,Y0,Z0,X1,Y1,Z1", value_parser = parse_box, allow_hyphen_values = true)]
    crop: Option<[Vec3; 2]>,
    /// Drop pieces of fewer than N connected triangles
    #[arg(long, value_name = "N")]
    components: Option<usize>,
    /// Keep this share of the triangles, above 0 and at most 1
    #[arg(long, value_name = "RATIO", value_parser = parse_ratio)]
    decimate: Option<f32>,
    /// Write the vertices as a point cloud
    #[arg(long)]
    points: bool,
    /// Which way is up in the file; by default it keeps the trajectory's world. GLB is always y-up
    #[arg(long, value_enum)]
    up: Option<UpArgument>,
    /// Keep so much of the map in memory; the rest goes to a temporary file
    #[arg(long, value_name = "MIB", default_value_t = 1024)]
    memory: u64,
    /// Adapter: auto, a number from 'itm devices' or a part of its name [default: that of the map's settings]
    #[arg(long)]
    device: Option<String>,
    /// Print what was made as JSON
    #[arg(long)]
    json: bool,
    /// Show no progress and print nothing
    #[arg(short, long)]
    quiet: bool,
}

pub(crate) fn run(arguments: &Arguments) -> Result<u8> {
    let out = &arguments.out;
    if arguments.writes_map() {
        return fuse(arguments);
    }
    if arguments.points {
        point_file::check_name(out)?
    } else {
        mesh_file::check_name(out)?
    }
    maps::check_folder_of(out)?;
    if let Some(slam) = maps::of_surfels(&arguments.map, arguments.device.as_deref())? {
        return of_surfels(arguments, slam);
    }
    let mut map = maps::open(&arguments.map, arguments.memory, arguments.quiet)?;
    if let Some(submap) = arguments.submap {
        maps::check_submap(&map, submap)?;
    }
    let device = maps::device(arguments.device.as_deref(), &map)?;
    let started = Instant::now();
    let bar = console::bar(0, "blocks meshed", arguments.quiet);
    let options = MeshOptions { min_weight: arguments.min_weight.unwrap_or(1), ..MeshOptions::default() };
    let mut progress = |done, all| {
        bar.set_length(all);
        bar.set_position(done);
    };
    let mesh = match arguments.submap {
        None => map.mesh(&device, &options, &mut progress),
        Some(submap) => map.mesh_submap(submap, &device, &options, &mut progress),
    };
    bar.finish_and_clear();
    let (mesh, seconds) = (mesh?, started.elapsed().as_secs_f64());
    let (blocks, text) = (map.blocks(), format!("{} blocks", map.blocks()));
    finish(arguments, mesh, seconds, ("blocks", blocks, &text))
}

/// Makes of a map's mesh what was asked for, writes it, and says so. `of` is what was meshed: its key in JSON, number, and text.
fn finish(arguments: &Arguments, mut mesh: Mesh, seconds: f64, of: (&str, usize, &str)) -> Result<u8> {
    let out = &arguments.out;
    if mesh.is_empty() {
        bail!(
            "the map '{}' has no surface where voxels were observed {} times",
            arguments.map.display(),
            arguments.min_weight.unwrap_or(1).max(1)
        );
    }
    let found = mesh.triangles.len();
    if let Some([min, max]) = arguments.crop {
        mesh = mesh.crop(min, max);
    }
    if let Some(least) = arguments.components {
        let dropped = mesh.drop_small_components(least);
        tracing::info!(dropped.components, dropped.triangles, "small pieces are dropped");
    }
    if let Some(ratio) = arguments.decimate {
        mesh = decimate(&mesh, ratio)?;
    }
    if mesh.is_empty() {
        bail!("nothing is left of {found} triangles after --crop, --components and --decimate");
    }
    let (vertices, triangles) = (mesh.positions.len(), mesh.triangles.len());
    let up = arguments.up.map(UpAxis::from);
    if arguments.points {
        point_file::write(out, &PointCloud::from(mesh), up.unwrap_or_default())?;
    } else {
        mesh_file::write(out, &mesh, &mesh_file::WriteOptions { up })?;
    }
    if arguments.json {
        let mut answer = json!({
            "file": out,
            "vertices": vertices,
            "triangles": if arguments.points { 0 } else { triangles },
            "triangles_meshed": found,
            "seconds_meshing": seconds,
        });
        answer[of.0] = of.1.into();
        console::print_json(&answer)?;
    } else if !arguments.quiet {
        let size = std::fs::metadata(out).map_or(0, |m| m.len()) as f64 / MIB as f64;
        let shown = out.display();
        let what = if arguments.points {
            format!("{vertices} points")
        } else {
            format!("{vertices} vertices, {triangles} triangles")
        };
        console::print(format_args!(
            "{shown}: {what}, {size:.1} MiB; {} meshed in {seconds:.1} s into {found} triangles",
            of.2
        ))?;
    }
    Ok(0)
}

/// The same for a map of surfels: the surfels themselves as points, or the mesh of what the camera would see of them along its way.
fn of_surfels(arguments: &Arguments, mut slam: Slam) -> Result<u8> {
    let of_voxels = [
        ("--submap", arguments.submap.is_some()),
        ("--fuse-submaps", arguments.fuse_submaps),
        ("--min-weight", !arguments.points && arguments.min_weight.is_some()),
        ("--components", arguments.points && arguments.components.is_some()),
        ("--decimate", arguments.points && arguments.decimate.is_some()),
    ];
    if let Some((option, _)) = of_voxels.into_iter().find(|(_, given)| *given) {
        let what = if arguments.points { "points of surfels" } else { "maps of surfels" };
        bail!("{option} says nothing of {what}, as '{}' has them", arguments.map.display());
    }
    let surfels = match arguments.min_weight {
        None => slam.surfels()?,
        Some(least) => {
            let mut all = slam.all_surfels()?;
            all.retain(|surfel| surfel.confidence >= least as f32);
            all
        }
    };
    if !arguments.points {
        let started = Instant::now();
        let bar = console::bar(0, "views meshed", arguments.quiet);
        let mesh = slam.mesh(&mut |done, all| {
            bar.set_length(all.into());
            bar.set_position(done.into());
        });
        bar.finish_and_clear();
        let text = format!("{} surfels", surfels.len());
        return finish(arguments, mesh?, started.elapsed().as_secs_f64(), ("surfels", surfels.len(), &text));
    }
    let inside = |surfel: &&Surfel| {
        let p = surfel.position;
        arguments.crop.is_none_or(|[min, max]| p.cmpge(min).all() && p.cmple(max).all())
    };
    let kept: Vec<Surfel> = surfels.iter().filter(inside).copied().collect();
    if kept.is_empty() {
        bail!("nothing is left of {} surfels", surfels.len());
    }
    point_file::write(&arguments.out, &cloud_of_surfels(&kept), arguments.up.map(UpAxis::from).unwrap_or_default())?;
    let shown = arguments.out.display();
    if arguments.json {
        console::print_json(
            &json!({ "file": arguments.out, "vertices": kept.len(), "triangles": 0, "surfels": surfels.len() }),
        )?;
    } else if !arguments.quiet {
        console::print(format_args!("{shown}: {} points of {} surfels", kept.len(), surfels.len()))?;
    }
    Ok(0)
}

impl Arguments {
    /// Whether a map file is asked for.
    fn writes_map(&self) -> bool {
        self.fuse_submaps && self.out.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("itm"))
    }
}

/// Writes the combined map as a map file of one submap.
fn fuse(arguments: &Arguments) -> Result<u8> {
    let out = &arguments.out;
    let of_meshes = [
        ("--crop", arguments.crop.is_some()),
        ("--components", arguments.components.is_some()),
        ("--decimate", arguments.decimate.is_some()),
        ("--points", arguments.points),
        ("--up", arguments.up.is_some()),
        ("--min-weight", arguments.min_weight.is_some()),
    ];
    if let Some((option, _)) = of_meshes.into_iter().find(|(_, given)| *given) {
        bail!("{option} is for meshes, and cannot go with the map file '{}'", out.display());
    }
    maps::check_folder_of(out)?;
    let mut map = maps::open(&arguments.map, arguments.memory, arguments.quiet)?;
    let submaps = map.submaps().len();
    let started = Instant::now();
    let bar = console::bar(0, "blocks fused", arguments.quiet);
    let blocks = map.fuse_submaps(out, &mut |done, all| {
        bar.set_length(all);
        bar.set_position(done);
    });
    bar.finish_and_clear();
    let (blocks, seconds) = (blocks?, started.elapsed().as_secs_f64());
    if arguments.json {
        console::print_json(&json!({ "file": out, "submaps": submaps, "blocks": blocks, "seconds": seconds }))?;
    } else if !arguments.quiet {
        console::print(format_args!(
            "{}: {blocks} blocks fused of {} in {submaps} submaps in {seconds:.1} s",
            out.display(),
            map.blocks()
        ))?;
    }
    Ok(0)
}

fn parse_box(text: &str) -> Result<[Vec3; 2]> {
    let [x0, y0, z0, x1, y1, z1] = maps::numbers(text)?;
    let (min, max) = (DVec3::new(x0, y0, z0), DVec3::new(x1, y1, z1));
    if !min.cmplt(max).all() {
        bail!("expected a box from its smallest to its largest coordinates, but '{text}' holds nothing");
    }
    Ok([min.as_vec3(), max.as_vec3()])
}

fn parse_ratio(text: &str) -> Result<f32, String> {
    let ratio = text.parse::<f32>().ok().filter(|ratio| *ratio > 0.0 && *ratio <= 1.0);
    ratio.ok_or_else(|| format!("expected a share above 0 and at most 1, not '{text}'"))
}
