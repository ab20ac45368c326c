//! What mesh and point cloud files have in common: axes, PLY's vertices.

use std::io::{self, Write};
use std::path::Path;

use glam::Vec3;

/// Which way is up in a file, for a mesh or point cloud whose world is that of a camera held upright: x right, y down, z forward.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum UpAxis {
    /// The world's own axes: x right, y down, z forward.
    #[default]
    YDown,
    /// x right, y up, z towards the viewer, as in glTF: `(x, -y, -z)` of the world.
    YUp,
    /// x right, y forward, z up, as in CAD, Blender and ROS: `(x, z, -y)` of the world.
    ZUp,
}

impl UpAxis {
    /// A position or direction of the world in the file's axes. Each is a rotation, so triangles keep their winding.
    pub(crate) fn turn(self, v: Vec3) -> Vec3 {
        match self {
            Self::YDown => v,
            Self::YUp => Vec3::new(v.x, -v.y, -v.z),
            Self::ZUp => Vec3::new(v.x, v.z, -v.y),
        }
    }
}

/// The part of a file's name that tells its format, in lower case; empty where there is none.
pub(crate) fn extension(path: &Path) -> String {
    path.extension().unwrap_or_default().to_string_lossy().to_lowercase()
}

/// A mesh's vertices or a cloud's points, whose parts fit together.
pub(crate) struct Vertices<'a> {
    pub(crate) positions: &'a [Vec3],
    pub(crate) normals: &'a [Vec3],
    pub(crate) colours: &'a [[u8; 3]],
    pub(crate) weights: Weights<'a>,
    pub(crate) confidences: &'a [f32],
}

/// Weights as whole numbers of observations, or as reals.
pub(crate) enum Weights<'a> {
    Counts(&'a [u16]),
    Reals(&'a [f32]),
}

impl Vertices<'_> {
    /// The header of a binary, little-endian PLY up to the vertices' last property.
    pub(crate) fn write_ply_header(&self, out: &mut dyn Write) -> io::Result<()> {
        writeln!(out, "ply\nformat binary_little_endian 1.0\ncomment written by itm, in metres")?;
        writeln!(out, "element vertex {}\nproperty float x\nproperty float y\nproperty float z", self.positions.len())?;
        if !self.normals.is_empty() {
            writeln!(out, "property float nx\nproperty float ny\nproperty float nz")?;
        }
        if !self.colours.is_empty() {
            writeln!(out, "property uchar red\nproperty uchar green\nproperty uchar blue")?;
        }
        match self.weights {
            Weights::Counts([]) | Weights::Reals([]) => {}
            Weights::Counts(_) => writeln!(out, "property ushort weight")?,
            Weights::Reals(_) => writeln!(out, "property float weight")?,
        }
        if !self.confidences.is_empty() {
            writeln!(out, "property float confidence")?;
        }
        Ok(())
    }

    /// The records that the header describes.
    pub(crate) fn write_ply_records(&self, out: &mut dyn Write, up: UpAxis) -> io::Result<()> {
        let mut record = Vec::new();
        for (i, position) in self.positions.iter().enumerate() {
            record.clear();
            push_floats(&mut record, up.turn(*position));
            if let Some(normal) = self.normals.get(i) {
                push_floats(&mut record, up.turn(*normal));
            }
            if let Some(colour) = self.colours.get(i) {
                record.extend_from_slice(colour);
            }
            match self.weights {
                Weights::Counts(counts) => record.extend(counts.get(i).into_iter().flat_map(|w| w.to_le_bytes())),
                Weights::Reals(reals) => record.extend(reals.get(i).into_iter().flat_map(|w| w.to_le_bytes())),
            }
            record.extend(self.confidences.get(i).into_iter().flat_map(|c| c.to_le_bytes()));
            out.write_all(&record)?;
        }
        Ok(())
    }
}

/// Three little-endian floats.
pub(crate) fn push_floats(record: &mut Vec<u8>, v: Vec3) {
    for c in v.to_array() {
        record.extend_from_slice(&c.to_le_bytes());
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use ply_rs_bw::parser::Parser;
    use std::fs::File;

    use ply_rs_bw::ply::{DefaultElement, Payload, Property};

    /// A PLY's elements by their names.
    pub(crate) fn read_ply_elements(path: &Path) -> Payload<DefaultElement> {
        Parser::<DefaultElement>::new().read_ply(&mut File::open(path).unwrap()).unwrap().payload
    }

    /// Appends what a vertex of a PLY has, without its weight.
    pub(crate) fn push_ply_vertex(
        vertex: &DefaultElement,
        positions: &mut Vec<Vec3>,
        normals: &mut Vec<Vec3>,
        colours: &mut Vec<[u8; 3]>,
    ) {
        let float = |key: &str| match vertex[key] {
            Property::Float(v) => v,
            ref other => panic!("{key} is {other:?}"),
        };
        let byte = |key: &str| match vertex[key] {
            Property::UChar(v) => v,
            ref other => panic!("{key} is {other:?}"),
        };
        positions.push(Vec3::new(float("x"), float("y"), float("z")));
        if vertex.contains_key("nx") {
            normals.push(Vec3::new(float("nx"), float("ny"), float("nz")));
        }
        if vertex.contains_key("red") {
            colours.push(["red", "green", "blue"].map(byte));
        }
    }
}
