//! Meshes as files for other programs: PLY, OBJ, STL and GLB. PLY is read, too.
//!
//! | format | holds besides positions and triangles |
//! | --- | --- |
//! | PLY (binary) | normals, colours, integration weights (`weight`), confidences (`confidence`) |
//! | OBJ | normals, colours (`v x y z r g b`, as MeshLab and others read them) |
//! | STL (binary) | a normal for each triangle |
//! | GLB (glTF 2.0) | normals, colours |
//!
//! All are in metres, triangles counter-clockwise seen from outside.

use std::io::{self, Write};
use std::path::Path;

use itm_core::Mesh;
use serde_json::json;

use crate::Error;
use crate::export::{self, Vertices, Weights, push_floats};
use crate::whole_file::write_whole;

pub use crate::export::UpAxis;

/// What may be chosen about a mesh file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WriteOptions {
    /// Which way is up in the file. By default PLY, OBJ and STL keep the world's axes, so that they agree with the
    /// trajectory. GLB is always y-up, which its format demands.
    pub up: Option<UpAxis>,
}

/// Writes a mesh in the format that the path's extension names: `.ply`, `.obj`, `.stl` or `.glb`, in either case.
///
/// The file takes its name only once it is whole: until then it stands beside it, as `.NAME.PROCESS.part`. A file of
/// that name is replaced.
///
/// # Errors
/// An extension that is none of these, a mesh whose parts do not fit together or whose positions are not finite, a mesh
/// too large for its format, or a file that cannot be written.
pub fn write(path: &Path, mesh: &Mesh, options: &WriteOptions) -> Result<(), Error> {
    let encode = encoder(path)?;
    let up = if export::extension(path) == "glb" { UpAxis::YUp } else { options.up.unwrap_or_default() };
    mesh.check().map_err(|reason| Error::Geometry { path: path.to_path_buf(), reason })?;
    write_whole(path, |out| encode(out, mesh, up)).map_err(|e| Error::io("write", path, e))
}

/// Reads a mesh from a PLY file: text, or binary of either order of bytes, as [`write()`] or another program made it.
///
/// Positions and triangles, and normals, colours (where they have 8 bits), weights and confidences where the file has them.
/// Polygons are split into fans of triangles. Normals that the file lacks are computed, see [`Mesh::compute_normals`]; normals
/// of another length than one are normalised. What else stands in the file is passed over. The axes are the file's.
///
/// # Errors
/// A file that cannot be read, is no PLY, ends too early, has no vertices, a position that is not finite or a face of a vertex
/// that is not there.
pub fn read(path: &Path) -> Result<Mesh, Error> {
    crate::ply::read_mesh(path)
}

/// Whether the path's extension names a format, so that a name that cannot be meant is refused before a mesh is made.
///
/// # Errors
/// Where it does not.
pub fn check_name(path: &Path) -> Result<(), Error> {
    encoder(path).map(|_| ())
}

type Encoder = fn(&mut dyn Write, &Mesh, UpAxis) -> io::Result<()>;

fn encoder(path: &Path) -> Result<Encoder, Error> {
    match export::extension(path).as_str() {
        "ply" => Ok(encode_ply),
        "obj" => Ok(encode_obj),
        "stl" => Ok(encode_stl),
        "glb" => Ok(encode_glb),
        _ => Err(Error::export_format(path, "mesh", ".ply, .obj, .stl or .glb")),
    }
}

/// The Polygon File Format, binary, little-endian.
fn encode_ply(out: &mut dyn Write, mesh: &Mesh, up: UpAxis) -> io::Result<()> {
    let vertices = Vertices {
        positions: &mesh.positions,
        normals: &mesh.normals,
        colours: &mesh.colours,
        weights: Weights::Counts(&mesh.weights),
        confidences: &mesh.confidences,
    };
    vertices.write_ply_header(out)?;
    writeln!(out, "element face {}\nproperty list uchar uint vertex_indices\nend_header", mesh.triangles.len())?;
    vertices.write_ply_records(out, up)?;
    let mut record = Vec::new();
    for triangle in &mesh.triangles {
        record.clear();
        record.push(3);
        record.extend(triangle.iter().flat_map(|v| v.to_le_bytes()));
        out.write_all(&record)?;
    }
    Ok(())
}

/// Wavefront OBJ, with colours between 0 and 1 behind the positions.
fn encode_obj(out: &mut dyn Write, mesh: &Mesh, up: UpAxis) -> io::Result<()> {
    writeln!(out, "# written by itm, in metres")?;
    for (i, position) in mesh.positions.iter().enumerate() {
        let p = up.turn(*position);
        write!(out, "v {} {} {}", p.x, p.y, p.z)?;
        if let Some(colour) = mesh.colours.get(i) {
            let [r, g, b] = colour.map(|c| f32::from(c) / 255.0);
            // Five decimals tell neighbours among 256 levels well apart.
            write!(out, " {r:.5} {g:.5} {b:.5}")?;
        }
        writeln!(out)?;
    }
    for normal in &mesh.normals {
        let n = up.turn(*normal);
        writeln!(out, "vn {} {} {}", n.x, n.y, n.z)?;
    }
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|v| u64::from(v) + 1);
        if mesh.normals.is_empty() {
            writeln!(out, "f {a} {b} {c}")?;
        } else {
            writeln!(out, "f {a}//{a} {b}//{b} {c}//{c}")?;
        }
    }
    Ok(())
}

/// Stereolithography, binary.
fn encode_stl(out: &mut dyn Write, mesh: &Mesh, up: UpAxis) -> io::Result<()> {
    let count = u32::try_from(mesh.triangles.len()).map_err(|_| too_large("2^32 - 1 triangles"))?;
    // The header must not start with 'solid', which means the text form.
    let mut record = b"written by itm, in metres".to_vec();
    record.resize(80, b' ');
    record.extend_from_slice(&count.to_le_bytes());
    out.write_all(&record)?;
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|v| up.turn(mesh.positions[v as usize]));
        record.clear();
        // The format's readers take a zero normal as 'compute it', which is all that can be said of a sliver.
        push_floats(&mut record, (b - a).cross(c - a).normalize_or_zero());
        [a, b, c].iter().for_each(|p| push_floats(&mut record, *p));
        record.extend_from_slice(&[0, 0]);
        out.write_all(&record)?;
    }
    Ok(())
}

/// glTF 2.0 in one binary file. A mesh without triangles becomes a scene of one empty node: glTF has no
/// empty accessors, and some readers refuse a scene without nodes.
fn encode_glb(out: &mut dyn Write, mesh: &Mesh, up: UpAxis) -> io::Result<()> {
    const MAGIC: u32 = 0x4654_6c67;
    const JSON_CHUNK: u32 = 0x4e4f_534a;
    const BINARY_CHUNK: u32 = 0x004e_4942;

    let (document, binary_bytes) = gltf_document(mesh, up);
    let mut document = document.to_string().into_bytes();
    document.resize(document.len().next_multiple_of(4), b' ');

    let has_binary = binary_bytes > 0;
    let total = 12 + 8 + document.len() + if has_binary { 8 + binary_bytes } else { 0 };
    let total = u32::try_from(total).map_err(|_| too_large("4 GiB"))?;
    let words = |words: &[u32]| -> Vec<u8> { words.iter().flat_map(|w| w.to_le_bytes()).collect() };
    // What is part of the total fits where the total does.
    out.write_all(&words(&[MAGIC, 2, total, document.len() as u32, JSON_CHUNK]))?;
    out.write_all(&document)?;
    if !has_binary {
        return Ok(());
    }

    out.write_all(&words(&[binary_bytes as u32, BINARY_CHUNK]))?;
    let mut record = Vec::new();
    for vector in mesh.positions.iter().chain(&mesh.normals) {
        record.clear();
        push_floats(&mut record, up.turn(*vector));
        out.write_all(&record)?;
    }
    if !mesh.colours.is_empty() {
        let linear = linear_levels();
        for colour in &mesh.colours {
            record.clear();
            for level in colour.map(|c| linear[usize::from(c)]).into_iter().chain([u16::MAX]) {
                record.extend_from_slice(&level.to_le_bytes());
            }
            out.write_all(&record)?;
        }
    }
    for triangle in &mesh.triangles {
        record.clear();
        record.extend(triangle.iter().flat_map(|v| v.to_le_bytes()));
        out.write_all(&record)?;
    }
    Ok(())
}

/// The JSON part, and the length of the binary part that it describes: positions, normals, colours, indices.
fn gltf_document(mesh: &Mesh, up: UpAxis) -> (serde_json::Value, usize) {
    const FLOAT: u32 = 5126;
    const UNSIGNED_SHORT: u32 = 5123;
    const UNSIGNED_INT: u32 = 5125;
    const ARRAY_BUFFER: u32 = 34962;
    const ELEMENT_ARRAY_BUFFER: u32 = 34963;

    let asset = json!({ "version": "2.0", "generator": "itm" });
    if mesh.is_empty() {
        return (json!({ "asset": asset, "scene": 0, "scenes": [{ "nodes": [0] }], "nodes": [{}] }), 0);
    }

    let (mut views, mut accessors, mut attributes) = (Vec::new(), Vec::new(), serde_json::Map::new());
    let mut bytes = 0;
    let mut add_view = |length: usize, target: u32| {
        views.push(json!({ "buffer": 0, "byteOffset": bytes, "byteLength": length, "target": target }));
        bytes += length;
        views.len() - 1
    };
    let vertices = mesh.positions.len();
    let mut add_attribute = |name: &str, view: usize, mut accessor: serde_json::Value| {
        accessor["bufferView"] = view.into();
        accessor["count"] = vertices.into();
        attributes.insert(name.into(), accessors.len().into());
        accessors.push(accessor);
    };

    let (low, high) = bounds(mesh, up);
    let view = add_view(vertices * 12, ARRAY_BUFFER);
    add_attribute("POSITION", view, json!({ "componentType": FLOAT, "type": "VEC3", "min": low, "max": high }));
    if !mesh.normals.is_empty() {
        let view = add_view(vertices * 12, ARRAY_BUFFER);
        add_attribute("NORMAL", view, json!({ "componentType": FLOAT, "type": "VEC3" }));
    }
    if !mesh.colours.is_empty() {
        // Sixteen bits: linear light in eight would leave the 13 darkest levels of sRGB as two.
        let view = add_view(vertices * 8, ARRAY_BUFFER);
        let accessor = json!({ "componentType": UNSIGNED_SHORT, "normalized": true, "type": "VEC4" });
        add_attribute("COLOR_0", view, accessor);
    }
    let view = add_view(mesh.triangles.len() * 12, ELEMENT_ARRAY_BUFFER);
    let indices = accessors.len();
    accessors.push(json!({
        "bufferView": view, "componentType": UNSIGNED_INT, "type": "SCALAR", "count": mesh.triangles.len() * 3,
    }));

    let document = json!({
        "asset": asset,
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [{ "attributes": attributes, "indices": indices, "material": 0 }] }],
        // The default material is metal, which looks black without surroundings to mirror.
        "materials": [{ "pbrMetallicRoughness": { "metallicFactor": 0.0, "roughnessFactor": 1.0 } }],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{ "byteLength": bytes }],
    });
    (document, bytes)
}

/// Smallest and largest coordinates in the file's axes.
fn bounds(mesh: &Mesh, up: UpAxis) -> ([f32; 3], [f32; 3]) {
    let (low, high) = mesh.bounds().unwrap_or_default();
    // A turn by right angles may swap a coordinate's ends.
    let (a, b) = (up.turn(low), up.turn(high));
    (a.min(b).to_array(), a.max(b).to_array())
}

/// Linear light, 0 to 65535, of each of the 256 levels of an sRGB channel (IEC 61966-2-1).
fn linear_levels() -> [u16; 256] {
    std::array::from_fn(|level| {
        let encoded = level as f64 / 255.0;
        let linear = if encoded <= 0.04045 { encoded / 12.92 } else { ((encoded + 0.055) / 1.055).powf(2.4) };
        (linear * 65535.0).round() as u16
    })
}

fn too_large(limit: &str) -> io::Error {
    io::Error::new(io::ErrorKind::FileTooLarge, format!("the format holds at most {limit}"))
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::export::tests::{push_ply_vertex, read_ply_elements};
    use glam::Vec3;
    use ply_rs_bw::ply::Property;
    use proptest::prelude::*;
    use std::fs::{self, File};
    use std::path::PathBuf;

    /// A triangle's corner as another program sees it.
    #[derive(Clone, Copy, Debug, PartialEq)]
    struct Corner {
        position: Vec3,
        normal: Option<Vec3>,
        colour: Option<[u8; 3]>,
    }

    fn corners(mesh: &Mesh, up: UpAxis) -> Vec<[Corner; 3]> {
        let corner = |v: u32| Corner {
            position: up.turn(mesh.positions[v as usize]),
            normal: mesh.normals.get(v as usize).map(|n| up.turn(*n)),
            colour: mesh.colours.get(v as usize).copied(),
        };
        mesh.triangles.iter().map(|t| t.map(corner)).collect()
    }

    fn write_in(folder: &Path, name: &str, mesh: &Mesh, up: Option<UpAxis>) -> PathBuf {
        let path = folder.join(name);
        write(&path, mesh, &WriteOptions { up }).unwrap();
        path
    }

    /// The mesh as read back from PLY; its axes are the file's.
    fn read_ply(path: &Path) -> Mesh {
        let elements = read_ply_elements(path);
        let mut mesh = Mesh::default();
        for v in &elements["vertex"] {
            push_ply_vertex(v, &mut mesh.positions, &mut mesh.normals, &mut mesh.colours);
            if let Some(Property::UShort(weight)) = v.get("weight") {
                mesh.weights.push(*weight);
            }
            if let Some(Property::Float(confidence)) = v.get("confidence") {
                mesh.confidences.push(*confidence);
            }
        }
        for f in &elements["face"] {
            let Property::ListUInt(ref indices) = f["vertex_indices"] else { panic!("{f:?}") };
            mesh.triangles.push(indices.as_slice().try_into().unwrap());
        }
        mesh
    }

    fn read_obj(path: &Path) -> Vec<[Corner; 3]> {
        let options = tobj::LoadOptions { single_index: true, ..Default::default() };
        let (models, _) = tobj::load_obj(path, &options).unwrap();
        let vector = |values: &[f32], i: u32| values.get(3 * i as usize..).and_then(|v| v.first_chunk::<3>()).copied();
        let mut triangles = Vec::new();
        for mesh in models.iter().map(|m| &m.mesh) {
            triangles.extend(mesh.indices.as_chunks::<3>().0.iter().map(|t| {
                t.map(|v| Corner {
                    position: vector(&mesh.positions, v).unwrap().into(),
                    normal: vector(&mesh.normals, v).map(Vec3::from),
                    colour: vector(&mesh.vertex_color, v).map(|c| c.map(|c| (c * 255.0).round() as u8)),
                })
            }));
        }
        triangles
    }

    fn read_glb(path: &Path) -> Vec<[Corner; 3]> {
        let (document, buffers, _) = gltf::import(path).unwrap();
        let mut triangles = Vec::new();
        for primitive in document.meshes().flat_map(|m| m.primitives().collect::<Vec<_>>()) {
            let reader = primitive.reader(|buffer| Some(&buffers[buffer.index()]));
            let positions: Vec<Vec3> = reader.read_positions().unwrap().map(Vec3::from).collect();
            let bounds = primitive.bounding_box();
            assert_eq!(Vec3::from(bounds.min), positions.iter().copied().reduce(Vec3::min).unwrap());
            assert_eq!(Vec3::from(bounds.max), positions.iter().copied().reduce(Vec3::max).unwrap());
            let normals: Option<Vec<Vec3>> = reader.read_normals().map(|n| n.map(Vec3::from).collect());
            let colours: Option<Vec<[u8; 3]>> = reader.read_colors(0).map(|c| {
                let encode = |[r, g, b, a]: [f32; 4]| {
                    assert_eq!(a, 1.0);
                    [r, g, b].map(|linear| {
                        let encoded =
                            if linear <= 0.0031308 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 };
                        (encoded * 255.0).round() as u8
                    })
                };
                c.into_rgba_f32().map(encode).collect()
            });
            let corner = |v: u32| Corner {
                position: positions[v as usize],
                normal: normals.as_ref().map(|n| n[v as usize]),
                colour: colours.as_ref().map(|c| c[v as usize]),
            };
            let indices: Vec<u32> = reader.read_indices().unwrap().into_u32().collect();
            triangles.extend(indices.as_chunks::<3>().0.iter().map(|t| t.map(corner)));
        }
        triangles
    }

    fn read_stl(path: &Path) -> Vec<([Vec3; 3], Vec3)> {
        let stl = stl_io::read_stl(&mut File::open(path).unwrap()).unwrap();
        let vector = |v: stl_io::Vector<f32>| Vec3::new(v[0], v[1], v[2]);
        stl.faces.iter().map(|f| (f.vertices.map(|v| vector(stl.vertices[v])), vector(f.normal))).collect()
    }

    /// Eight faces, wound counter-clockwise seen from outside.
    fn octahedron() -> Mesh {
        let axes = [Vec3::X, Vec3::Y, Vec3::Z, Vec3::NEG_X, Vec3::NEG_Y, Vec3::NEG_Z];
        Mesh {
            positions: axes.iter().map(|a| a * 0.5 + Vec3::new(3.0, 1.0, 2.0)).collect(),
            normals: axes.to_vec(),
            colours: vec![[0, 1, 2], [3, 12, 13], [60, 128, 200], [255, 254, 253], [9, 90, 0], [11, 22, 33]],
            weights: vec![0, 1, 255, 256, 10_000, u16::MAX],
            confidences: vec![0.0, 0.0625, 1.0, 2.5, 80.0, 4095.9375],
            triangles: vec![[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]],
        }
    }

    pub(crate) fn meshes() -> impl Strategy<Value = Mesh> {
        let vector = || prop::array::uniform3(-1e3..1e3f32).prop_map(Vec3::from);
        (1..20usize, any::<[bool; 4]>()).prop_flat_map(move |(vertices, [normals, colours, weights, confidences])| {
            let of = move |present: bool| if present { vertices } else { 0 };
            (
                prop::collection::vec(vector(), vertices),
                prop::collection::vec(vector().prop_map(|v| v.normalize_or(Vec3::X)), of(normals)),
                prop::collection::vec(any::<[u8; 3]>(), of(colours)),
                prop::collection::vec(any::<u16>(), of(weights)),
                prop::collection::vec(0.0..4096.0f32, of(confidences)),
                prop::collection::vec(prop::array::uniform3(0..vertices as u32), 0..30),
            )
                .prop_map(|(positions, normals, colours, weights, confidences, triangles)| Mesh {
                    positions,
                    normals,
                    colours,
                    weights,
                    confidences,
                    triangles,
                })
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn other_programs_read_what_was_written(
            mesh in meshes(),
            up in prop::sample::select(vec![UpAxis::YDown, UpAxis::YUp, UpAxis::ZUp]),
        ) {
            let folder = tempfile::tempdir().unwrap();
            let expected = corners(&mesh, up);

            let ply = read_ply(&write_in(folder.path(), "m.ply", &mesh, Some(up)));
            prop_assert_eq!(corners(&ply, UpAxis::YDown), expected.clone());
            prop_assert_eq!((&ply.weights, ply.positions.len()), (&mesh.weights, mesh.positions.len()));

            prop_assert_eq!(read_obj(&write_in(folder.path(), "m.obj", &mesh, Some(up))), expected.clone());
            prop_assert_eq!(
                read_glb(&write_in(folder.path(), "m.glb", &mesh, Some(up))),
                corners(&mesh, UpAxis::YUp)
            );
            let stl = read_stl(&write_in(folder.path(), "m.stl", &mesh, Some(up)));
            let positions: Vec<_> = stl.into_iter().map(|(positions, _)| positions).collect();
            prop_assert_eq!(positions, expected.iter().map(|t| t.map(|c| c.position)).collect::<Vec<_>>());
        }
    }

    #[test]
    fn triangles_face_outwards_whichever_way_is_up() {
        let folder = tempfile::tempdir().unwrap();
        for up in [UpAxis::YDown, UpAxis::YUp, UpAxis::ZUp] {
            for name in ["m.ply", "m.obj", "m.glb"] {
                let path = write_in(folder.path(), name, &octahedron(), Some(up));
                let triangles = match name {
                    "m.ply" => corners(&read_ply(&path), UpAxis::YDown),
                    "m.obj" => read_obj(&path),
                    _ => read_glb(&path),
                };
                assert_eq!(triangles.len(), 8);
                for [a, b, c] in triangles {
                    let facing = (b.position - a.position).cross(c.position - a.position);
                    assert!([a, b, c].iter().all(|v| facing.dot(v.normal.unwrap()) > 0.0), "{name} {up:?}");
                }
            }
            for ([a, b, c], normal) in read_stl(&write_in(folder.path(), "m.stl", &octahedron(), Some(up))) {
                assert!((b - a).cross(c - a).normalize().dot(normal) > 0.999999);
            }
        }
    }

    #[test]
    fn each_format_has_its_default_axes() {
        let folder = tempfile::tempdir().unwrap();
        let first = |triangles: Vec<[Corner; 3]>| triangles[0][0].position;
        // The world's vertex 0 is at (3.5, 1, 2): 1 m below and 2 m ahead of the camera.
        let ply = |up| first(corners(&read_ply(&write_in(folder.path(), "m.PLY", &octahedron(), up)), UpAxis::YDown));
        assert_eq!(ply(None), Vec3::new(3.5, 1.0, 2.0));
        assert_eq!(ply(Some(UpAxis::YUp)), Vec3::new(3.5, -1.0, -2.0));
        assert_eq!(ply(Some(UpAxis::ZUp)), Vec3::new(3.5, 2.0, -1.0));
        let obj = first(read_obj(&write_in(folder.path(), "m.obj", &octahedron(), None)));
        assert_eq!(obj, Vec3::new(3.5, 1.0, 2.0));
        assert_eq!(read_stl(&write_in(folder.path(), "m.stl", &octahedron(), None))[0].0[0], Vec3::new(3.5, 1.0, 2.0));
        for up in [None, Some(UpAxis::ZUp)] {
            let glb = first(read_glb(&write_in(folder.path(), "m.glb", &octahedron(), up)));
            assert_eq!(glb, Vec3::new(3.5, -1.0, -2.0));
        }
    }

    #[test]
    fn empty_meshes_are_files_that_open() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name| write_in(folder.path(), name, &Mesh::default(), None);
        assert_eq!(read_ply(&path("m.ply")), Mesh::default());
        assert!(read_obj(&path("m.obj")).is_empty());
        assert!(read_stl(&path("m.stl")).is_empty());
        assert!(read_glb(&path("m.glb")).is_empty());
    }

    #[test]
    fn every_dark_level_survives_linear_light() {
        let levels = linear_levels();
        assert_eq!((levels[0], levels[255]), (0, 65535));
        assert!(levels.is_sorted_by(|a, b| a < b));
    }

    #[test]
    fn meshes_that_no_file_can_hold_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("m.stl");
        let refused = |mesh: Mesh| {
            let error = write(&path, &mesh, &WriteOptions::default()).unwrap_err().to_string();
            assert!(error.contains("m.stl") && fs::read_dir(folder.path()).unwrap().next().is_none(), "{error}");
            error
        };
        let error = refused(Mesh { colours: vec![[0; 3]], ..octahedron() });
        assert!(error.contains("found 1 colours for 6 vertices"), "{error}");
        let error = refused(Mesh { triangles: vec![[0, 1, 2], [3, 6, 4]], ..octahedron() });
        assert!(error.contains("triangle 1 of vertices 3, 6 and 4 of 6"), "{error}");
        let mut mesh = octahedron();
        mesh.positions[2].y = f32::NAN;
        assert!(refused(mesh).contains("vertex 2"));
    }

    #[test]
    fn unknown_extensions_name_the_known_ones() {
        for name in ["mesh.vtk", "mesh", ".ply"] {
            let error = write(Path::new(name), &octahedron(), &WriteOptions::default()).unwrap_err().to_string();
            assert!(error.contains(name) && error.contains(".ply, .obj, .stl or .glb"), "{error}");
        }
    }

    #[test]
    fn places_that_cannot_be_written_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let taken = folder.path().join("taken.ply");
        fs::create_dir(&taken).unwrap();
        for path in [folder.path().join("no such folder").join("m.glb"), taken] {
            let error = write(&path, &octahedron(), &WriteOptions::default()).unwrap_err().to_string();
            assert!(error.starts_with("cannot write") && error.contains(&*path.to_string_lossy()), "{error}");
        }
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
