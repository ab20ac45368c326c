//! Point clouds as files for other programs: PLY, PCD and XYZ.
//!
//! | format | holds besides positions |
//! | --- | --- |
//! | PLY (binary) | normals, colours, weights (`weight`), confidences (`confidence`) |
//! | PCD (version 0.7, binary) | normals, colours (`rgb`, packed as PCL does), weights (`weight`), confidences (`confidence`) |
//! | XYZ (text) | normals, colours |
//!
//! All are in metres. An XYZ file has no header: each line is a point, `x y z`, then `nx ny nz` where there are normals,
//! then `r g b` as whole numbers from 0 to 255 where there are colours, with a space between. It has no place for weights
//! and confidences.

use std::io::{self, Write};
use std::path::Path;

use itm_core::PointCloud;

use crate::Error;
use crate::export::{self, Vertices, Weights, push_floats};
use crate::whole_file::write_whole;

pub use crate::export::UpAxis;

/// Writes a point cloud in the format that the path's extension names: `.ply`, `.pcd` or `.xyz`, in either case.
///
/// `up` says which way is up in the file; by default the world's axes stay, so that the cloud agrees with the trajectory.
/// The file takes its name only once it is whole, as [`mesh::write`](crate::mesh::write)'s does.
///
/// # Errors
/// An extension that is none of these, a cloud whose parts do not fit together or are not finite, or a file that cannot be
/// written.
pub fn write(path: &Path, cloud: &PointCloud, up: UpAxis) -> Result<(), Error> {
    let encode = encoder(path)?;
    cloud.check().map_err(|reason| Error::Geometry { path: path.to_path_buf(), reason })?;
    write_whole(path, |out| encode(out, cloud, up)).map_err(|e| Error::io("write", path, e))
}

/// Whether the path's extension names a format, so that a name that cannot be meant is refused before a cloud is made.
///
/// # Errors
/// Where it does not.
pub fn check_name(path: &Path) -> Result<(), Error> {
    encoder(path).map(|_| ())
}

type Encoder = fn(&mut dyn Write, &PointCloud, UpAxis) -> io::Result<()>;

fn encoder(path: &Path) -> Result<Encoder, Error> {
    match export::extension(path).as_str() {
        "ply" => Ok(encode_ply),
        "pcd" => Ok(encode_pcd),
        "xyz" => Ok(encode_xyz),
        _ => Err(Error::export_format(path, "point cloud", ".ply, .pcd or .xyz")),
    }
}

/// The Polygon File Format, binary, little-endian.
fn encode_ply(out: &mut dyn Write, cloud: &PointCloud, up: UpAxis) -> io::Result<()> {
    let points = Vertices {
        positions: &cloud.positions,
        normals: &cloud.normals,
        colours: &cloud.colours,
        weights: Weights::Reals(&cloud.weights),
        confidences: &cloud.confidences,
    };
    points.write_ply_header(out)?;
    writeln!(out, "end_header")?;
    points.write_ply_records(out, up)
}

/// The Point Cloud Library's format, binary: fields of four bytes each, little-endian as on all machines that run PCL.
fn encode_pcd(out: &mut dyn Write, cloud: &PointCloud, up: UpAxis) -> io::Result<()> {
    let mut fields = vec!["x", "y", "z"];
    if !cloud.normals.is_empty() {
        fields.extend(["normal_x", "normal_y", "normal_z"]);
    }
    if !cloud.colours.is_empty() {
        fields.push("rgb");
    }
    if !cloud.weights.is_empty() {
        fields.push("weight");
    }
    if !cloud.confidences.is_empty() {
        fields.push("confidence");
    }
    let points = cloud.positions.len();
    writeln!(out, "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS {}", fields.join(" "))?;
    for (key, value) in [("SIZE", "4"), ("TYPE", "F"), ("COUNT", "1")] {
        writeln!(out, "{key} {}", vec![value; fields.len()].join(" "))?;
    }
    writeln!(out, "WIDTH {points}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {points}\nDATA binary")?;

    let mut record = Vec::new();
    for (i, position) in cloud.positions.iter().enumerate() {
        record.clear();
        push_floats(&mut record, up.turn(*position));
        if let Some(normal) = cloud.normals.get(i) {
            push_floats(&mut record, up.turn(*normal));
        }
        if let Some(&[r, g, b]) = cloud.colours.get(i) {
            // PCL declares a float, and reads its bits as 0x00rrggbb.
            record.extend_from_slice(&[b, g, r, 0]);
        }
        for of_all in [&cloud.weights, &cloud.confidences] {
            record.extend(of_all.get(i).into_iter().flat_map(|value| value.to_le_bytes()));
        }
        out.write_all(&record)?;
    }
    Ok(())
}

/// Text without a header; numbers in the fewest digits that read back as the same float.
fn encode_xyz(out: &mut dyn Write, cloud: &PointCloud, up: UpAxis) -> io::Result<()> {
    for (i, position) in cloud.positions.iter().enumerate() {
        let p = up.turn(*position);
        write!(out, "{} {} {}", p.x, p.y, p.z)?;
        if let Some(normal) = cloud.normals.get(i) {
            let n = up.turn(*normal);
            write!(out, " {} {} {}", n.x, n.y, n.z)?;
        }
        if let Some([r, g, b]) = cloud.colours.get(i) {
            write!(out, " {r} {g} {b}")?;
        }
        writeln!(out)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::tests::{push_ply_vertex, read_ply_elements};
    use glam::Vec3;
    use ply_rs_bw::ply::Property;
    use proptest::prelude::*;
    use std::fs;

    fn read_ply(path: &Path) -> PointCloud {
        let elements = read_ply_elements(path);
        assert_eq!(elements.keys().collect::<Vec<_>>(), ["vertex"]);
        let mut cloud = PointCloud::default();
        for v in &elements["vertex"] {
            push_ply_vertex(v, &mut cloud.positions, &mut cloud.normals, &mut cloud.colours);
            if let Some(Property::Float(weight)) = v.get("weight") {
                cloud.weights.push(*weight);
            }
            if let Some(Property::Float(confidence)) = v.get("confidence") {
                cloud.confidences.push(*confidence);
            }
        }
        cloud
    }

    /// Reads PCD as its description says, in the order of PCL's header.
    fn read_pcd(path: &Path) -> PointCloud {
        let bytes = fs::read(path).unwrap();
        let mut rest = &bytes[..];
        let mut header = Vec::new();
        while header.last().is_none_or(|(key, _): &(String, Vec<String>)| key != "DATA") {
            let end = rest.iter().position(|&b| b == b'\n').unwrap();
            let mut words = str::from_utf8(&rest[..end]).unwrap().split(' ').map(str::to_owned);
            header.push((words.next().unwrap(), words.collect()));
            rest = &rest[end + 1..];
        }
        assert_eq!(header.remove(0).0, "#");
        let keys: Vec<&str> = header.iter().map(|(key, _)| &**key).collect();
        let all = "VERSION FIELDS SIZE TYPE COUNT WIDTH HEIGHT VIEWPOINT POINTS DATA";
        assert_eq!(keys, all.split(' ').collect::<Vec<_>>());
        let value = |key: &str| &header.iter().find(|(k, _)| k == key).unwrap().1;
        let fields = value("FIELDS");
        assert_eq!((value("VERSION")[0].as_str(), value("DATA")[0].as_str()), ("0.7", "binary"));
        for (key, each) in [("SIZE", "4"), ("TYPE", "F"), ("COUNT", "1")] {
            assert_eq!(*value(key), vec![each; fields.len()]);
        }
        let points: usize = value("POINTS")[0].parse().unwrap();
        assert_eq!((&value("WIDTH")[0], value("HEIGHT")[0].as_str()), (&value("POINTS")[0], "1"));
        assert_eq!(rest.len(), points * fields.len() * 4);

        let mut cloud = PointCloud::default();
        for point in rest.chunks_exact(fields.len() * 4) {
            let bits = |name: &str| {
                let field = fields.iter().position(|f| f == name)?;
                Some(u32::from_le_bytes(point[4 * field..][..4].try_into().unwrap()))
            };
            let float = |name: &str| bits(name).map(f32::from_bits);
            let vector = |names: [&str; 3]| {
                Some(Vec3::from(names.map(|n| float(n).unwrap_or(f32::NAN)))).filter(|v| v.is_finite())
            };
            cloud.positions.push(vector(["x", "y", "z"]).unwrap());
            cloud.normals.extend(vector(["normal_x", "normal_y", "normal_z"]));
            cloud.colours.extend(bits("rgb").map(|c| [(c >> 16) as u8, (c >> 8) as u8, c as u8]));
            cloud.weights.extend(float("weight"));
            cloud.confidences.extend(float("confidence"));
        }
        cloud
    }

    fn read_xyz(path: &Path, has_normals: bool) -> PointCloud {
        let mut cloud = PointCloud::default();
        for line in fs::read_to_string(path).unwrap().lines() {
            let words: Vec<&str> = line.split(' ').collect();
            let vector = |at: usize| Vec3::from_slice(&[0, 1, 2].map(|i| words[at + i].parse().unwrap()));
            cloud.positions.push(vector(0));
            let mut colour_at = 3;
            if has_normals {
                cloud.normals.push(vector(3));
                colour_at = 6;
            }
            if let Some(&[r, g, b]) = words.get(colour_at..colour_at + 3).and_then(|w| w.first_chunk()) {
                cloud.colours.push([r, g, b].map(|c| c.parse().unwrap()));
                colour_at += 3;
            }
            assert_eq!(words.len(), colour_at, "{line}");
        }
        cloud
    }

    fn turned(cloud: &PointCloud, up: UpAxis) -> PointCloud {
        let turn = |vectors: &[Vec3]| vectors.iter().map(|v| up.turn(*v)).collect();
        PointCloud { positions: turn(&cloud.positions), normals: turn(&cloud.normals), ..cloud.clone() }
    }

    fn clouds() -> impl Strategy<Value = PointCloud> {
        let vector = || prop::array::uniform3(-1e3..1e3f32).prop_map(Vec3::from);
        (0..20usize, any::<[bool; 4]>()).prop_flat_map(move |(points, [normals, colours, weights, confidences])| {
            let of = move |present: bool| if present { points } else { 0 };
            let parts = (
                prop::collection::vec(vector(), points),
                prop::collection::vec(vector().prop_map(|v| v.normalize_or(Vec3::X)), of(normals)),
                prop::collection::vec(any::<[u8; 3]>(), of(colours)),
                prop::collection::vec(0.0..1e5f32, of(weights)),
                prop::collection::vec(0.0..1e3f32, of(confidences)),
            );
            parts.prop_map(|(positions, normals, colours, weights, confidences)| PointCloud {
                positions,
                normals,
                colours,
                weights,
                confidences,
            })
        })
    }

    fn cloud() -> PointCloud {
        PointCloud {
            positions: vec![Vec3::new(3.5, 1.0, 2.0), Vec3::new(-0.1, 100.25, 1e-7)],
            normals: vec![Vec3::X, Vec3::new(0.0, 0.6, -0.8)],
            colours: vec![[1, 128, 255], [255, 254, 0]],
            weights: vec![0.5, 10_000.0],
            confidences: vec![0.25, 12.0],
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn what_was_written_reads_back(
            cloud in clouds(),
            up in prop::sample::select(vec![UpAxis::YDown, UpAxis::YUp, UpAxis::ZUp]),
        ) {
            let folder = tempfile::tempdir().unwrap();
            let written = |name: &str| {
                let path = folder.path().join(name);
                write(&path, &cloud, up).unwrap();
                path
            };
            let expected = turned(&cloud, up);
            prop_assert_eq!(read_ply(&written("c.ply")), expected.clone());
            prop_assert_eq!(read_pcd(&written("c.PCD")), expected.clone());
            let text = read_xyz(&written("c.xyz"), !cloud.normals.is_empty());
            prop_assert_eq!(text, PointCloud { weights: Vec::new(), confidences: Vec::new(), ..expected });
            prop_assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 3);
        }
    }

    #[test]
    fn files_are_what_other_programs_expect() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("c.xyz");
        write(&path, &cloud(), UpAxis::default()).unwrap();
        let text = fs::read_to_string(&path).unwrap();
        assert_eq!(text, "3.5 1 2 1 0 0 1 128 255\n-0.1 100.25 0.0000001 0 0.6 -0.8 255 254 0\n");

        let path = folder.path().join("c.pcd");
        write(&path, &cloud(), UpAxis::ZUp).unwrap();
        let header = "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\n\
            FIELDS x y z normal_x normal_y normal_z rgb weight confidence\n\
            SIZE 4 4 4 4 4 4 4 4 4\nTYPE F F F F F F F F F\n\
            COUNT 1 1 1 1 1 1 1 1 1\nWIDTH 2\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2\nDATA binary\n";
        let bytes = fs::read(&path).unwrap();
        assert_eq!(bytes[..header.len()], *header.as_bytes());
        let first: [f32; 3] = floats(&bytes[header.len()..]);
        assert_eq!(first, [3.5, 2.0, -1.0], "z is up");
    }

    fn floats(bytes: &[u8]) -> [f32; 3] {
        [0, 4, 8].map(|at| f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()))
    }

    #[test]
    fn clouds_that_no_file_can_hold_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["c.ply", "c.pcd", "c.xyz"] {
            let path = folder.path().join(name);
            for bad in [
                PointCloud { colours: vec![[0; 3]], ..cloud() },
                PointCloud { weights: vec![1.0, f32::NAN], ..cloud() },
                PointCloud { positions: vec![Vec3::ZERO, Vec3::INFINITY], ..cloud() },
            ] {
                let error = write(&path, &bad, UpAxis::YDown).unwrap_err();
                assert!(matches!(error, Error::Geometry { .. }) && error.to_string().contains(name), "{error}");
            }
        }
        for name in ["c.las", "c", ".pcd"] {
            let error = write(Path::new(name), &cloud(), UpAxis::YDown).unwrap_err().to_string();
            assert!(error.contains("point cloud") && error.contains(".ply, .pcd or .xyz"), "{error}");
        }
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
