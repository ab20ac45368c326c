//! Turns the WGSL files into typed Rust: resolves imports and variants (WESL), validates (naga), reflects the bindings
//! and host-shared structs (naga), and writes one Rust module a pass.
//!
//! A pass is a `.wgsl` file outside `shared/` with one compute entry point `main`, or, where it rasterises, with the entry
//! points `vertex` and `fragment`. What this program insists on, so that the generated code stays simple: every host-shared
//! struct is free of padding, so that its Rust twin is plain `Pod`; there is at most one uniform, named `params`; every
//! other binding is a storage buffer, which what rasterises only reads.

#![expect(clippy::print_stderr, reason = "a build script is a program, and stderr is where cargo shows its errors")]

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use naga::{AddressSpace, ArraySize, Scalar, ScalarKind, StorageAccess, TypeInner, VectorSize};

/// Passes that come in several variants, for the features that the file's `@if(...)` ask for. Each entry of a pass is a choice
/// of feature sets; the variants are all combinations. Passes that are not listed have one variant without features.
const VARIANTS: &[(&str, &[Choice])] = &[
    ("associate/visible", &[&[&[], &["removing"], &["of_submap"], &["removing", "of_submap"], &["combined"]]]),
    ("confidence", &[PAGES]),
    ("integrate", &[F32, COLOUR, WEIGHTED, CONFIDENCE]),
    ("mesh/gather", &[F32]),
    ("mesh/signs", &[F32]),
    ("mesh/vertices", &[F32, COLOUR, CONFIDENCE]),
    ("photometric/map", &[PAGES]),
    ("photometric/sums", &[&[&[], &["rgb"]]]),
    ("query", &[F32, PAGES]),
    ("raycast", &[F32, LISTED, PAGES]),
    ("render/colour", &[PAGES]),
    ("shrink/average", &[COLOUR]),
    ("splat/front", &[COMBINED]),
    ("splat/lay", &[COMBINED]),
    ("swap/empty", &[F32]),
    // Colours, confidences, distances of both kinds.
    ("swap/merge", &[&[&[], &["confidences"], &["distances"], &["f32", "distances"]]]),
];

type Choice = &'static [&'static [&'static str]];

const F32: Choice = &[&[], &["f32"]];
const COLOUR: Choice = &[&[], &["colour"]];
const WEIGHTED: Choice = &[&[], &["weighted"]];
const CONFIDENCE: Choice = &[&[], &["confidence"]];
const COMBINED: Choice = &[&[], &["combined"]];
const LISTED: Choice = &[&[], &["listed"]];
const PAGES: Choice = &[&[], &["pages2"], &["pages2", "pages3"], &["pages2", "pages3", "pages4"]];

/// All combinations of choices, each one's features in the choices' order.
fn combinations(choices: &[Choice]) -> Vec<Vec<&'static str>> {
    choices.iter().fold(vec![Vec::new()], |before, choice| {
        let with = |features: &Vec<&'static str>, set: &&[&'static str]| [features.as_slice(), *set].concat();
        before.iter().flat_map(|features| choice.iter().map(|set| with(features, set))).collect()
    })
}

type Result<T> = std::result::Result<T, String>;

fn main() {
    let root = PathBuf::from(std::env::var("CARGO_MANIFEST_DIR").expect("cargo sets CARGO_MANIFEST_DIR"));
    let out = PathBuf::from(std::env::var("OUT_DIR").expect("cargo sets OUT_DIR"));
    println!("cargo::rerun-if-changed=build.rs");
    match generate(&root) {
        Ok(code) => std::fs::write(out.join("passes.rs"), code).expect("OUT_DIR is writable"),
        Err(message) => {
            // Printed rather than panicked with: the message is for whoever edits a shader, and has line breaks.
            eprintln!("{message}");
            std::process::exit(1);
        }
    }
}

fn generate(root: &Path) -> Result<String> {
    let mut files = Vec::new();
    find_shaders(root, root, &mut files)?;
    files.sort();
    for (name, _) in VARIANTS {
        if !files.iter().any(|f| f == name) {
            return Err(format!("build.rs lists variants of '{name}', but there is no {name}.wgsl"));
        }
    }
    let mut structs = BTreeMap::new();
    let mut modules: BTreeMap<String, String> = BTreeMap::new();
    let mut passes = Vec::new();
    for file in files.iter().filter(|f| !f.starts_with("shared/")) {
        let pass = Pass::new(root, file)?;
        let mut code = String::new();
        pass.write(&mut structs, &mut code)?;
        passes.push(file.replace('/', "::"));
        modules.insert(file.clone(), code);
    }
    let mut code = String::from("// Generated from the WGSL files by build.rs.\n\n");
    write_modules(&modules, &mut code);
    code += "/// Structs that several passes share.\npub mod types {\n";
    for text in structs.values() {
        code += text;
    }
    code += "}\n\n/// Every pass, by file name.\npub const ALL: &[&crate::Pass] = &[\n";
    for path in &passes {
        let _ = writeln!(code, "    &{path}::PASS,");
    }
    code += "];\n";
    Ok(code)
}

fn find_shaders(root: &Path, folder: &Path, files: &mut Vec<String>) -> Result<()> {
    println!("cargo::rerun-if-changed={}", folder.display());
    let unreadable = |e: std::io::Error| format!("{}: {e}", folder.display());
    for entry in std::fs::read_dir(folder).map_err(unreadable)? {
        let path = entry.map_err(unreadable)?.path();
        if path.is_dir() {
            if !["src", "target"].iter().any(|skip| path.ends_with(skip)) {
                find_shaders(root, &path, files)?;
            }
        } else if path.extension().is_some_and(|e| e == "wgsl") {
            println!("cargo::rerun-if-changed={}", path.display());
            let relative = path.strip_prefix(root).expect("found below root").with_extension("");
            files.push(relative.to_string_lossy().replace('\\', "/"));
        }
    }
    Ok(())
}

/// Nests the passes' modules by folder.
fn write_modules(modules: &BTreeMap<String, String>, code: &mut String) {
    let mut folders: BTreeMap<&str, Vec<(&str, &str)>> = BTreeMap::new();
    for (file, text) in modules {
        let (folder, name) = file.split_once('/').unwrap_or(("", file));
        folders.entry(folder).or_default().push((name, text));
    }
    for (folder, passes) in folders {
        if !folder.is_empty() {
            let _ = writeln!(code, "/// The passes in `{folder}/`.\npub mod {folder} {{");
        }
        for (name, text) in passes {
            let path = if folder.is_empty() { name.to_string() } else { format!("{folder}/{name}") };
            let _ = writeln!(code, "/// The pass in `{path}.wgsl`.\npub mod {name} {{\n{text}}}\n");
        }
        if !folder.is_empty() {
            *code += "}\n";
        }
    }
}

struct Binding {
    name: String,
    group: u32,
    binding: u32,
    read_only: bool,
    uniform: Option<naga::Handle<naga::Type>>,
}

struct Variant {
    features: Vec<&'static str>,
    source: String,
    module: naga::Module,
    bindings: Vec<Binding>,
}

struct Pass {
    file: String,
    doc: String,
    variants: Vec<Variant>,
}

impl Pass {
    fn new(root: &Path, file: &str) -> Result<Self> {
        let choices = VARIANTS.iter().find(|(name, _)| *name == file).map_or(&[][..], |(_, choices)| choices);
        let text =
            std::fs::read_to_string(root.join(format!("{file}.wgsl"))).map_err(|e| format!("{file}.wgsl: {e}"))?;
        let doc = text.lines().map_while(|l| l.strip_prefix("//")).map(|l| format!("///{l}\n")).collect::<String>();
        if doc.is_empty() {
            return Err(format!("{file}.wgsl must start with a comment that says what the pass does"));
        }
        let known: BTreeSet<&'static str> =
            VARIANTS.iter().flat_map(|(_, choices)| combinations(choices)).flatten().collect();
        let variants = combinations(choices)
            .into_iter()
            .map(|features| Variant::new(root, file, features, &known))
            .collect::<Result<Vec<_>>>()?;
        Ok(Self { file: file.into(), doc, variants })
    }

    fn write(&self, structs: &mut BTreeMap<String, String>, code: &mut String) -> Result<()> {
        let name = &self.file;
        // The union of the variants' bindings: one that only some have becomes an Option.
        let mut union: BTreeMap<(u32, u32), (&Binding, usize)> = BTreeMap::new();
        for binding in self.variants.iter().flat_map(|v| &v.bindings) {
            let entry = union.entry((binding.group, binding.binding)).or_insert((binding, 0));
            if entry.0.name != binding.name {
                return Err(format!("{name}.wgsl: '{}' and '{}' share a binding", entry.0.name, binding.name));
            }
            entry.1 += 1;
        }
        let widest = self.variants.iter().max_by_key(|v| v.bindings.len()).expect("a pass has a variant");
        let uniform = widest.bindings.iter().find_map(|b| b.uniform);
        if let Some(handle) = uniform {
            write_struct(&widest.module, handle, name, structs, code)?;
        }

        let _ = writeln!(code, "/// What `{name}.wgsl` reads and writes.\npub struct Bindings<'a> {{");
        for (binding, count) in union.values() {
            let field = &binding.name;
            if binding.uniform.is_some() {
                let _ = writeln!(code, "    /// The uniform.\n    pub {field}: Params,");
            } else {
                let access = if binding.read_only { "read" } else { "read and written" };
                let ty = if *count == self.variants.len() { "&'a wgpu::Buffer" } else { "Option<&'a wgpu::Buffer>" };
                let _ = writeln!(code, "    /// Storage, {access}.\n    pub {field}: {ty},");
            }
        }
        code.push_str(
            "}\n\nimpl crate::Bindings for Bindings<'_> {\n    const PASS: &'static crate::Pass = &PASS;\n\n",
        );
        let uniform_bytes = if uniform.is_some() { "bytemuck::bytes_of(&self.params)" } else { "&[]" };
        let _ = writeln!(code, "    fn uniform(&self) -> &[u8] {{\n        {uniform_bytes}\n    }}\n");
        code.push_str("    fn storage(&self, group: u32, binding: u32) -> Option<&wgpu::Buffer> {\n        match (group, binding) {\n");
        for ((group, slot), (binding, count)) in &union {
            if binding.uniform.is_none() {
                let field = &binding.name;
                let value =
                    if *count == self.variants.len() { format!("Some(self.{field})") } else { format!("self.{field}") };
                let _ = writeln!(code, "            ({group}, {slot}) => {value},");
            }
        }
        code.push_str("            _ => None,\n        }\n    }\n}\n\n");

        let _ = write!(
            code,
            "{}pub const PASS: crate::Pass = crate::Pass {{\n    name: {name:?},\n    variants: &[\n",
            self.doc
        );
        for variant in &self.variants {
            let _ = writeln!(
                code,
                "        crate::Variant {{ features: &{:?}, source: {:?}, bindings: &[",
                variant.features, variant.source
            );
            for b in &variant.bindings {
                let kind = match (b.uniform.is_some(), b.read_only) {
                    (true, _) => "Uniform",
                    (false, true) => "ReadOnly",
                    (false, false) => "ReadWrite",
                };
                let _ = writeln!(
                    code,
                    "            crate::Slot {{ name: {:?}, group: {}, binding: {}, kind: crate::SlotKind::{kind} }},",
                    b.name, b.group, b.binding
                );
            }
            code.push_str("        ] },\n");
        }
        code.push_str("    ],\n};\n");
        Ok(())
    }
}

impl Variant {
    fn new(root: &Path, file: &str, features: Vec<&'static str>, known: &BTreeSet<&'static str>) -> Result<Self> {
        let place =
            || if features.is_empty() { format!("{file}.wgsl") } else { format!("{file}.wgsl with {features:?}") };
        let mut compiler = wesl::Wesl::new(root);
        for feature in known {
            compiler.set_feature(feature, features.contains(feature));
        }
        let path = format!("package::{}", file.replace('/', "::"));
        let path = path.parse().map_err(|e| format!("{}: {e:?}", place()))?;
        let source = compiler.compile(&path).map_err(|e| format!("{}: {e}", place()))?.to_string();
        let explain = |e: &dyn Fn(&str) -> String| format!("{}:\n{}", place(), e(&source));
        let module = naga::front::wgsl::parse_str(&source).map_err(|e| explain(&|s| e.emit_to_string(s)))?;
        naga::valid::Validator::new(naga::valid::ValidationFlags::all(), naga::valid::Capabilities::empty())
            .validate(&module)
            .map_err(|e| explain(&|s| e.emit_to_string(s)))?;
        let mut entries: Vec<_> = module.entry_points.iter().map(|entry| (entry.name.as_str(), entry.stage)).collect();
        entries.sort_unstable_by_key(|(name, _)| *name);
        let rasterises = match entries[..] {
            [("main", naga::ShaderStage::Compute)] => false,
            [("fragment", naga::ShaderStage::Fragment), ("vertex", naga::ShaderStage::Vertex)] => true,
            _ => {
                return Err(format!(
                    "{}: the entry points must be a compute shader 'main', or shaders 'vertex' and 'fragment', not {entries:?}",
                    place()
                ));
            }
        };
        let mut bindings = Vec::new();
        for (_, variable) in module.global_variables.iter() {
            let Some(at) = variable.binding else { continue };
            let mangled = variable.name.clone().unwrap_or_default();
            let (read_only, uniform) = match variable.space {
                AddressSpace::Uniform => (true, Some(variable.ty)),
                AddressSpace::Storage { access } => (!access.contains(StorageAccess::STORE), None),
                _ => return Err(format!("{}: '{mangled}' is neither a uniform nor a storage buffer", place())),
            };
            let name = short_name(&mangled);
            if rasterises && !read_only {
                return Err(format!(
                    "{}: '{name}' is written, which not every device can where it rasterises",
                    place()
                ));
            }
            if uniform.is_some() != (name == "params") {
                return Err(format!("{}: '{name}': the uniform, and nothing else, is named 'params'", place()));
            }
            bindings.push(Binding { name, group: at.group, binding: at.binding, read_only, uniform });
        }
        bindings.sort_by_key(|b| (b.group, b.binding));
        Ok(Self { features, source, module, bindings })
    }
}

/// WESL names what it imports `package_shared_module_name`, and a name that has underscores itself `_1a_b`, with their
/// number in front.
fn short_name(mangled: &str) -> String {
    let Some((_, name)) = mangled.strip_prefix("package_shared_").and_then(|rest| rest.split_once('_')) else {
        return mangled.to_string();
    };
    name.strip_prefix('_').map_or(name, |counted| counted.trim_start_matches(|c: char| c.is_ascii_digit())).to_string()
}

/// Writes the Rust twin of a host-shared struct: into `structs` where it is shared between passes, otherwise into
/// `code`. Returns its Rust name.
fn write_struct(
    module: &naga::Module,
    handle: naga::Handle<naga::Type>,
    pass: &str,
    structs: &mut BTreeMap<String, String>,
    code: &mut String,
) -> Result<String> {
    let ty = &module.types[handle];
    let mangled = ty.name.clone().unwrap_or_default();
    let TypeInner::Struct { members, span } = &ty.inner else {
        return Err(format!("{pass}.wgsl: params must be a struct"));
    };
    let name = short_name(&mangled);
    let shared = name != mangled;
    let mut text = String::new();
    let (mut end, mut fields, mut checks) = (0, String::new(), String::new());
    for member in members {
        let field = member.name.clone().unwrap_or_default();
        if member.offset != end {
            return Err(format!(
                "{pass}.wgsl: {name}.{field} lies at byte {}, {} after the field before it: order the fields, or fill the \
                 gap with one, so that the struct has no padding",
                member.offset,
                member.offset - end
            ));
        }
        let (rust, size) = rust_type(module, member.ty, pass, structs)?;
        end = member.offset + size;
        let _ = writeln!(fields, "    /// Byte {}.\n    pub {field}: {rust},", member.offset);
        let _ = writeln!(checks, "    assert!(core::mem::offset_of!({name}, {field}) == {});", member.offset);
    }
    if end != *span {
        return Err(format!("{pass}.wgsl: {name} ends in {} bytes of padding: fill them with a field", span - end));
    }
    let _ = writeln!(
        text,
        "/// `{name}` in WGSL; {span} bytes.\n#[repr(C)]\n#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, \
         bytemuck::Zeroable)]\npub struct {name} {{\n{fields}}}\n\nconst _: () = {{\n{checks}    \
         assert!(core::mem::size_of::<{name}>() == {span});\n}};\n"
    );
    if shared {
        if structs.insert(name.clone(), text.clone()).is_some_and(|other| other != text) {
            return Err(format!("{pass}.wgsl: two shared structs are named {name}"));
        }
    } else {
        code.push_str(&text);
    }
    Ok(name)
}

fn rust_type(
    module: &naga::Module,
    handle: naga::Handle<naga::Type>,
    pass: &str,
    structs: &mut BTreeMap<String, String>,
) -> Result<(String, u32)> {
    let scalar = |s: &Scalar| match (s.kind, s.width) {
        (ScalarKind::Float, 4) => Ok("f32"),
        (ScalarKind::Uint, 4) => Ok("u32"),
        (ScalarKind::Sint, 4) => Ok("i32"),
        _ => Err(format!("{pass}.wgsl: {s:?} has no Rust twin here")),
    };
    let count = |size: &VectorSize| *size as u32;
    match &module.types[handle].inner {
        TypeInner::Scalar(s) => Ok((scalar(s)?.into(), 4)),
        TypeInner::Vector { size, scalar: s } => Ok((format!("[{}; {}]", scalar(s)?, count(size)), 4 * count(size))),
        TypeInner::Matrix { columns, rows: VectorSize::Quad, scalar: s } => {
            Ok((format!("[[{}; 4]; {}]", scalar(s)?, count(columns)), 16 * count(columns)))
        }
        TypeInner::Array { base, size: ArraySize::Constant(n), stride } => {
            let (element, size) = rust_type(module, *base, pass, structs)?;
            if size != *stride {
                return Err(format!("{pass}.wgsl: an array of {element} has padding between its elements"));
            }
            Ok((format!("[{element}; {n}]"), stride * n.get()))
        }
        TypeInner::Struct { span, .. } => {
            let mut own = String::new();
            let name = write_struct(module, handle, pass, structs, &mut own)?;
            if !own.is_empty() {
                return Err(format!("{pass}.wgsl: {name} is used within params, so it belongs in shared/"));
            }
            Ok((format!("crate::types::{name}"), *span))
        }
        other => Err(format!("{pass}.wgsl: {other:?} has no Rust twin here")),
    }
}
