//! Meshes from PLY files (Turk 1994), our own and other programs'.

use std::fs::File;
use std::io::{self, BufRead, BufReader, ErrorKind};
use std::path::Path;

use glam::Vec3;
use itm_core::Mesh;
use ply_rs_bw::parser::{ParseError, Parser, Reader};
use ply_rs_bw::ply::{ElementDef, Encoding, Property, PropertyAccess, PropertyAccessResult, PropertyType, ScalarType};

use crate::{Error, text};

/// Elements that room is made for before any has been read: a header may promise more than the file holds.
const BELIEVED: usize = 1 << 16;
const FACES: [&str; 2] = ["vertex_indices", "vertex_index"];

pub(crate) fn read_mesh(path: &Path) -> Result<Mesh, Error> {
    let file = File::open(path).map_err(|e| Error::io("open", path, e))?;
    let mut source = BufReader::with_capacity(1 << 20, file);
    let start = source.fill_buf().map_err(|e| Error::io("read", path, e))?;
    if !(start.starts_with(b"ply\n") || start.starts_with(b"ply\r\n")) {
        return Err(Error::NotAPly { path: path.to_path_buf() });
    }
    let mut reader = Reader::new(source);
    let header = Parser::<Skipped>::new().read_header(&mut reader).map_err(|e| header_error(path, &e))?;
    let line = reader.line();
    let mut elements =
        Elements { path, encoding: header.encoding, source: reader.into_inner(), line, text: String::new() };

    let vertices = header.elements.get("vertex").map_or(0, |vertex| vertex.count);
    if vertices == 0 {
        return Err(content(path, "its header", "an element 'vertex' of at least one", "no vertices"));
    }
    let mut mesh = Mesh::default();
    for element in header.elements.values() {
        match element.name.as_str() {
            "vertex" => elements.read_vertices(element, &mut mesh)?,
            "face" => elements.read_faces(element, vertices, &mut mesh)?,
            _ => elements.skip(element)?,
        }
    }
    if mesh.normals.is_empty() && !mesh.is_empty() {
        mesh.compute_normals();
    }
    Ok(mesh)
}

/// What follows the header.
struct Elements<'a, R> {
    path: &'a Path,
    encoding: Encoding,
    source: R,
    /// Of a text file, the number of the line that is read next, and the line that was read last.
    line: usize,
    text: String,
}

impl<R: BufRead> Elements<'_, R> {
    fn read_vertices(&mut self, element: &ElementDef, mesh: &mut Mesh) -> Result<(), Error> {
        let scalar = |name: &str| match &element.properties.get(name)?.data_type {
            PropertyType::Scalar(scalar) => Some(scalar.clone()),
            PropertyType::List(..) => None,
        };
        let has = |names: &[&str]| names.iter().all(|name| scalar(name).is_some());
        if !has(&["x", "y", "z"]) {
            let found = element.properties.keys().cloned().collect::<Vec<_>>().join(", ");
            return Err(content(self.path, "its header", "vertices with x, y and z", found));
        }
        let normals = has(&["nx", "ny", "nz"]);
        let colours = ["red", "green", "blue"].iter().all(|name| scalar(name) == Some(ScalarType::UChar));
        let (weights, confidences) = (has(&["weight"]), has(&["confidence"]));

        mesh.positions.reserve(element.count.min(BELIEVED));
        let parser = Parser::new();
        for i in 0..element.count {
            let vertex: Vertex = self.next(&parser, element, i)?;
            if !vertex.position.is_finite() {
                return Err(self.wrong(element, i, "a finite position", vertex.position.to_string()));
            }
            mesh.positions.push(vertex.position);
            if normals {
                let normal = vertex.normal;
                mesh.normals.push(if normal.is_normalized() { normal } else { normal.normalize_or_zero() });
            }
            if colours {
                mesh.colours.push(vertex.colour);
            }
            if weights {
                // Our own are counts already; more than the largest stays the largest.
                mesh.weights.push(vertex.weight.round() as u16);
            }
            if confidences {
                mesh.confidences.push(vertex.confidence);
            }
        }
        Ok(())
    }

    /// Polygons become fans of triangles around their first vertex.
    fn read_faces(&mut self, element: &ElementDef, vertices: usize, mesh: &mut Mesh) -> Result<(), Error> {
        let is_list = |name: &&str| {
            let list = element.properties.get(*name).map(|p| &p.data_type);
            list.is_some_and(|list| {
                matches!(list, PropertyType::List(_, of) if !matches!(of, ScalarType::Float | ScalarType::Double))
            })
        };
        if element.count > 0 && !FACES.iter().any(is_list) {
            let found = element.properties.keys().cloned().collect::<Vec<_>>().join(", ");
            return Err(content(self.path, "its header", "faces with a list vertex_indices of whole numbers", found));
        }
        mesh.triangles.reserve(element.count.min(BELIEVED));
        let parser = Parser::new();
        let mut corners: Vec<u32> = Vec::new();
        for i in 0..element.count {
            let face: Face = self.next(&parser, element, i)?;
            corners.clear();
            for vertex in face.0 {
                let inside = usize::try_from(vertex).is_ok_and(|v| v < vertices);
                let Some(vertex) = u32::try_from(vertex).ok().filter(|_| inside) else {
                    let expected = format!("vertices 0 to {}", vertices - 1);
                    return Err(self.wrong(element, i, expected, format!("vertex {vertex}")));
                };
                corners.push(vertex);
            }
            if let Some((&first, others)) = corners.split_first() {
                mesh.triangles.extend(others.windows(2).map(|pair| [first, pair[0], pair[1]]));
            }
        }
        Ok(())
    }

    fn skip(&mut self, element: &ElementDef) -> Result<(), Error> {
        // What has no bytes would be skipped as often as the header says.
        if element.properties.is_empty() && self.encoding != Encoding::Ascii {
            return Ok(());
        }
        let parser = Parser::new();
        (0..element.count).try_for_each(|i| self.next::<Skipped>(&parser, element, i).map(|_| ()))
    }

    fn next<E: PropertyAccess>(&mut self, parser: &Parser<E>, element: &ElementDef, i: usize) -> Result<E, Error> {
        let read = match self.encoding {
            Encoding::BinaryLittleEndian => parser.read_little_endian_element(&mut self.source, element),
            Encoding::BinaryBigEndian => parser.read_big_endian_element(&mut self.source, element),
            Encoding::Ascii => {
                self.text.clear();
                match self.source.read_line(&mut self.text) {
                    Ok(0) => Err(io::Error::from(ErrorKind::UnexpectedEof).into()),
                    Ok(_) => {
                        self.line += 1;
                        parser.read_ascii_element(&self.text, element)
                    }
                    Err(e) => Err(e.into()),
                }
            }
        };
        read.map_err(|e| match e.kind() {
            ErrorKind::UnexpectedEof => Error::PlyCutOff {
                path: self.path.to_path_buf(),
                within: format!("{} {i} of {}", element.name, element.count),
            },
            ErrorKind::InvalidInput | ErrorKind::InvalidData if self.encoding == Encoding::Ascii => {
                let names = element.properties.keys().map(String::as_str).collect::<Vec<_>>().join(" ");
                self.wrong(element, i, format!("numbers '{names}'"), text::quoted(self.text.trim()))
            }
            ErrorKind::InvalidInput | ErrorKind::InvalidData => {
                self.wrong(element, i, "what its header says", e.to_string())
            }
            _ => Error::io("read", self.path, e.into()),
        })
    }

    /// That the element read last is not as expected: a line of a text file, or by its number.
    fn wrong(&self, element: &ElementDef, i: usize, expected: impl Into<String>, found: String) -> Error {
        match self.encoding {
            Encoding::Ascii => Error::line(self.path, self.line - 1, expected, found),
            _ => content(self.path, &format!("{} {i}", element.name), expected, found),
        }
    }
}

fn content(path: &Path, place: &str, expected: impl Into<String>, found: impl Into<String>) -> Error {
    Error::PlyContent { path: path.to_path_buf(), place: place.into(), expected: expected.into(), found: found.into() }
}

fn header_error(path: &Path, error: &ParseError) -> Error {
    match (error.kind(), error.line()) {
        (ErrorKind::UnexpectedEof, _) => Error::PlyCutOff { path: path.to_path_buf(), within: "its header".into() },
        (ErrorKind::InvalidInput, Some(line)) => {
            // The parser's own words come with its grammar; the line itself says more.
            let lines = File::open(path).map(|file| BufReader::new(file).lines());
            let found = lines.ok().and_then(|mut lines| lines.nth(line - 1)?.ok()).unwrap_or_default();
            Error::line(path, line, "a line of a PLY header", text::quoted(found.trim()))
        }
        _ => content(path, "its header", "a PLY header", error.to_string()),
    }
}

/// A vertex as the file has it; what it lacks stays zero.
#[derive(Default)]
struct Vertex {
    position: Vec3,
    normal: Vec3,
    colour: [u8; 3],
    weight: f32,
    confidence: f32,
}

impl PropertyAccess for Vertex {
    fn new() -> Self {
        Self::default()
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        let value = match property {
            Property::Char(v) => v.into(),
            Property::UChar(v) => v.into(),
            Property::Short(v) => v.into(),
            Property::UShort(v) => v.into(),
            Property::Int(v) => v as f32,
            Property::UInt(v) => v as f32,
            Property::Float(v) => v,
            Property::Double(v) => v as f32,
            _ => return PropertyAccessResult::Ignored,
        };
        match name {
            "x" => self.position.x = value,
            "y" => self.position.y = value,
            "z" => self.position.z = value,
            "nx" => self.normal.x = value,
            "ny" => self.normal.y = value,
            "nz" => self.normal.z = value,
            "red" => self.colour[0] = value as u8,
            "green" => self.colour[1] = value as u8,
            "blue" => self.colour[2] = value as u8,
            "weight" => self.weight = value,
            "confidence" => self.confidence = value,
            _ => return PropertyAccessResult::Ignored,
        }
        PropertyAccessResult::Set
    }
}

/// The vertices of a polygon, as the file numbers them.
#[derive(Default)]
struct Face(Vec<i64>);

impl PropertyAccess for Face {
    fn new() -> Self {
        Self::default()
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        fn wide<T: Into<i64>>(values: Vec<T>) -> Vec<i64> {
            values.into_iter().map(Into::into).collect()
        }
        if !FACES.contains(&name) {
            return PropertyAccessResult::Ignored;
        }
        self.0 = match property {
            Property::ListChar(v) => wide(v),
            Property::ListUChar(v) => wide(v),
            Property::ListShort(v) => wide(v),
            Property::ListUShort(v) => wide(v),
            Property::ListInt(v) => wide(v),
            Property::ListUInt(v) => wide(v),
            _ => return PropertyAccessResult::UnsupportedType,
        };
        PropertyAccessResult::Set
    }
}

/// An element that is of no use here.
struct Skipped;

impl PropertyAccess for Skipped {
    fn new() -> Self {
        Self
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::tests::meshes;
    use crate::mesh::{self, WriteOptions};
    use proptest::prelude::*;
    use std::fs;

    fn read(bytes: &[u8]) -> Result<Mesh, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("m.ply");
        fs::write(&path, bytes).unwrap();
        let read = mesh::read(&path).map_err(|e| e.to_string());
        if let Err(error) = &read {
            assert!(error.contains("m.ply"), "{error}");
        }
        read
    }

    fn refused(bytes: impl AsRef<[u8]>) -> String {
        read(bytes.as_ref()).unwrap_err()
    }

    /// A square and a triangle, as text, with what other programs add.
    const ASCII: &str = "ply\nformat ascii 1.0\ncomment by hand\nobj_info none\nelement vertex 5\nproperty float32 x\n\
        property double y\nproperty int z\nproperty uchar red\nproperty uint8 green\nproperty uchar blue\n\
        property uchar alpha\nelement edge 1\nproperty int from\nproperty list uchar int to\nelement face 2\n\
        property uchar flags\nproperty list uchar int vertex_index\nend_header\n\
        0 0 3 255 0 0 9\n1 0 3 0 255 0 9\n1.0 1e0 3 0 0 255 9\n-0.5 1 3 1 2 3 9\n7 7 3 4 5 6 9\n3 2 1 2\n\
        0 4 0 1 2 3\n0 3 1 4 2\n";

    /// The same, as bytes of either order, with a list of 16 bits.
    fn binary(big: bool) -> Vec<u8> {
        let order = if big { "big" } else { "little" };
        let mut bytes = format!(
            "ply\r\nformat binary_{order}_endian 1.0\r\nelement vertex 5\r\nproperty float x\r\nproperty float y\r\n\
             property float z\r\nelement face 2\r\nproperty list ushort short vertex_indices\r\nend_header\r\n"
        )
        .into_bytes();
        for v in
            [[0.0_f32, 0.0, 3.0], [1.0, 0.0, 3.0], [1.0, 1.0, 3.0], [-0.5, 1.0, 3.0], [7.0, 7.0, 3.0]].as_flattened()
        {
            bytes.extend(if big { v.to_be_bytes() } else { v.to_le_bytes() });
        }
        for v in [4_u16, 0, 1, 2, 3, 3, 1, 4, 2] {
            bytes.extend(if big { v.to_be_bytes() } else { v.to_le_bytes() });
        }
        bytes
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn what_was_written_reads_back(mesh in meshes()) {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("m.ply");
            mesh::write(&path, &mesh, &WriteOptions::default()).unwrap();
            let mut expected = mesh;
            if expected.normals.is_empty() && !expected.is_empty() {
                expected.compute_normals();
            }
            prop_assert_eq!(mesh::read(&path).unwrap(), expected);
        }

        #[test]
        fn damaged_files_are_read_or_refused(
            big: bool, text: bool, cut in 0.0..1.0, at in 0.0..1.0, byte: u8,
        ) {
            let mut bytes = if text { ASCII.trim_end().as_bytes().to_vec() } else { binary(big) };
            let place = |share: f64| (share * bytes.len() as f64) as usize;
            let (cut, at) = (place(cut), place(at));
            refused(&bytes[..cut]);
            bytes[at] = byte;
            if let Ok(mesh) = read(&bytes) {
                mesh.check().unwrap();
            }
        }
    }

    #[test]
    fn text_and_both_orders_of_bytes_are_one_mesh() {
        let text = read(ASCII.as_bytes()).unwrap();
        assert_eq!(text.positions[3], Vec3::new(-0.5, 1.0, 3.0));
        assert_eq!(text.colours, [[255, 0, 0], [0, 255, 0], [0, 0, 255], [1, 2, 3], [4, 5, 6]]);
        assert_eq!(text.triangles, [[0, 1, 2], [0, 2, 3], [1, 4, 2]]);
        assert_eq!(text.normals[0], Vec3::Z, "flat, and counter-clockwise seen from +z");
        for big in [false, true] {
            let bytes = read(&binary(big)).unwrap();
            assert_eq!(bytes, Mesh { colours: Vec::new(), ..text.clone() });
        }
    }

    #[test]
    fn a_file_that_is_no_mesh_says_where() {
        for bytes in [&b""[..], b"solid cube", b"plywood\n", &[0, 159, 146, 150]] {
            assert!(refused(bytes).contains("not a PLY file"));
        }
        let with = |from: &str, to: &str| {
            assert!(ASCII.contains(from));
            refused(ASCII.replacen(from, to, 1))
        };
        let error = with("property double y", "property decimal y");
        assert!(error.contains("line 7") && error.contains("'property decimal y'"), "{error}");
        let error = with("property double y\n", "");
        assert!(error.contains("x, y and z") && error.contains("x, z, red"), "{error}");
        let error = with("vertex_index", "corners");
        assert!(error.contains("vertex_indices") && error.contains("flags, corners"), "{error}");
        let error = with("element vertex 5", "element vertex 0");
        assert!(error.contains("no vertices"), "{error}");
        let error = with("-0.5 1 3 1 2 3 9", "-0.5 1 three 1 2 3 9");
        assert!(error.contains("line 23") && error.contains("three"), "{error}");
        let error = with("-0.5 1 3", "-0.5 1e99 3");
        assert!(error.contains("line 23") && error.contains("finite"), "{error}");
        let error = with("0 3 1 4 2\n", "0 3 1 5 2\n");
        assert!(error.contains("line 27") && error.contains("vertex 5") && error.contains("0 to 4"), "{error}");
        let error = with("0 3 1 4 2\n", "0 3 1 -1 2\n");
        assert!(error.contains("vertex -1"), "{error}");
        let error = with("0 3 1 4 2\n", "");
        assert!(error.contains("cut off") && error.contains("face 1 of 2"), "{error}");

        let mut bytes = binary(true);
        let end = bytes.len();
        bytes[end - 3] = 9;
        assert!(refused(&bytes).contains("face 1: expected vertices 0 to 4, found vertex 9"));
        let end = end - 18 - 20;
        bytes[end..end + 4].copy_from_slice(&f32::INFINITY.to_be_bytes());
        assert!(refused(&bytes).contains("vertex 3: expected a finite position"));
    }

    #[test]
    fn a_header_that_promises_too_much_is_not_believed() {
        let promise = |text: &str, from: &str, to: &str| refused(text.replacen(from, to, 1));
        let most = u64::MAX.to_string();
        let error = promise(ASCII, "vertex 5", &format!("vertex {most}"));
        assert!(error.contains("m.ply"), "{error}");
        assert!(promise(ASCII, "0 3 1 4 2", "0 99999999999 1 4 2").contains("line 27"));
        let start = "ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty char x\nproperty char y\n\
            property char z\n";
        let error =
            refused(format!("{start}element face {most}\nproperty list uint int vertex_index\nend_header\nabcdefg"));
        assert!(error.contains(&format!("cut off: it ends within face 0 of {most}")), "{error}");
        let mesh = read(format!("{start}element nothing {most}\nend_header\nabc").as_bytes()).unwrap();
        assert_eq!((mesh.positions.len(), mesh.is_empty(), mesh.normals.is_empty()), (1, true, true));
    }
}
