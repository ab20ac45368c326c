//! Every variant of every pass translates to what each backend of wgpu hands to its driver. The cheapest evidence for
//! 'runs on any GPU' where none is at hand.

use std::collections::BTreeSet;
use std::path::Path;

use itm_shaders::{ALL, Pass, SlotKind, Variant};
use naga::ShaderStage;
use naga::back::{hlsl, msl, pipeline_constants::process_overrides, spv};
use naga::valid::{Capabilities, ModuleInfo, ValidationFlags, Validator};

/// Calls `translate` with each entry point of each variant, validated, once with its overrides' defaults.
fn for_each_entry_point(translate: impl Fn(&naga::Module, &ModuleInfo, ShaderStage) -> Result<(), String>) {
    let mut failures = Vec::new();
    for pass in ALL {
        for variant in pass.variants {
            let translated = resolve(variant).and_then(|entries| {
                entries.iter().try_for_each(|(module, info, stage)| translate(module, info, *stage))
            });
            if let Err(e) = translated {
                failures.push(format!("{}: {e}", name(pass, variant)));
            }
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

fn name(pass: &Pass, variant: &Variant) -> String {
    format!("{} {:?}", pass.name, variant.features)
}

/// A module for each entry point.
fn resolve(variant: &Variant) -> Result<Vec<(naga::Module, ModuleInfo, ShaderStage)>, String> {
    let module = naga::front::wgsl::parse_str(variant.source).map_err(|e| e.emit_to_string(variant.source))?;
    // No capability beyond what every WebGPU adapter has.
    let info = Validator::new(ValidationFlags::all(), Capabilities::empty())
        .validate(&module)
        .map_err(|e| e.emit_to_string(variant.source))?;
    let entries = module.entry_points.iter().map(|entry| {
        let constants = naga::back::PipelineConstants::default();
        let (module, info) = process_overrides(&module, &info, Some((entry.stage, &entry.name)), &constants)
            .map_err(|e| e.to_string())?;
        Ok((module.into_owned(), info.into_owned(), entry.stage))
    });
    entries.collect()
}

#[test]
fn to_spirv_for_vulkan() {
    for_each_entry_point(|module, info, _| {
        let options = spv::Options { lang_version: (1, 3), ..Default::default() };
        let words = spv::write_vec(module, info, &options, None).map_err(|e| e.to_string())?;
        if words.first() == Some(&0x0723_0203) { Ok(()) } else { Err("no SPIR-V".into()) }
    });
}

#[test]
fn to_msl_for_metal() {
    for_each_entry_point(|module, info, stage| {
        // Metal 1.2 came with macOS 10.12, the oldest that Rust supports. Faked bindings stand in for the slots that a
        // pipeline layout would give.
        let options = msl::Options { lang_version: (1, 2), fake_missing_bindings: true, ..Default::default() };
        let (text, info) =
            msl::write_string(module, info, &options, &msl::PipelineOptions::default()).map_err(|e| e.to_string())?;
        for name in info.entry_point_names {
            name.map_err(|e| e.to_string())?;
        }
        let start = match stage {
            ShaderStage::Vertex => "\nvertex ",
            ShaderStage::Fragment => "\nfragment ",
            _ => "kernel void",
        };
        if text.contains(start) { Ok(()) } else { Err(format!("no {start}")) }
    });
}

#[test]
fn to_hlsl_for_direct3d_12() {
    for_each_entry_point(|module, info, stage| {
        let options =
            hlsl::Options { shader_model: hlsl::ShaderModel::V6_0, fake_missing_bindings: true, ..Default::default() };
        let mut text = String::new();
        let written = hlsl::Writer::new(&mut text, &options, &hlsl::PipelineOptions::default())
            .write(module, info, None)
            .map_err(|e| e.to_string())?;
        for name in written.entry_point_names {
            name.map_err(|e| e.to_string())?;
        }
        let sign = match stage {
            ShaderStage::Vertex => "SV_Position",
            ShaderStage::Fragment => "SV_Target1",
            _ => "[numthreads(",
        };
        if text.contains(sign) { Ok(()) } else { Err(format!("no {sign}")) }
    });
}

#[test]
fn every_shader_file_is_a_pass_or_shared() {
    fn find(root: &Path, folder: &Path, found: &mut BTreeSet<String>) {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let relative = path.strip_prefix(root).unwrap().with_extension("");
            let name = relative.to_str().unwrap().replace('\\', "/");
            if path.is_dir() {
                if !["shared", "src", "target", "tests"].contains(&name.as_str()) {
                    find(root, &path, found);
                }
            } else if path.extension().is_some_and(|e| e == "wgsl") {
                found.insert(name);
            }
        }
    }
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut files = BTreeSet::new();
    find(root, root, &mut files);
    assert!(files.contains("raycast") && files.contains("view/bilateral"), "{files:?}");
    let passes: BTreeSet<String> = ALL.iter().map(|p| p.name.to_string()).collect();
    assert_eq!(files, passes);
    assert_eq!(passes.len(), ALL.len(), "no two passes have one name");
    for pass in ALL {
        assert!(pass.variants[0].features.is_empty(), "the first variant of {} has no features", pass.name);
    }
}

/// The smallest adapters and the default limits of a host's device offer eight storage buffers a shader. Only the variants
/// for more pages may need more: they are used where the adapter offers it.
#[test]
fn no_pass_needs_more_than_eight_storage_buffers() {
    for pass in ALL {
        for variant in pass.variants.iter().filter(|v| !v.features.iter().any(|f| f.starts_with("pages"))) {
            let storage = variant.bindings.iter().filter(|slot| slot.kind != SlotKind::Uniform).count();
            assert!(storage <= 8, "{} binds {storage} storage buffers", name(pass, variant));
        }
    }
}

/// What the other tests go through has the variants that are built on features: a feature that `build.rs` no longer lists
/// would leave them untested.
#[test]
fn passes_with_features_have_a_variant_for_each() {
    let features = |wanted: &str| -> Vec<&[&str]> {
        let pass = ALL.iter().find(|p| p.name == wanted).unwrap_or_else(|| panic!("no pass is called {wanted}"));
        pass.variants.iter().map(|v| v.features).collect()
    };
    let pages: [&[&str]; 4] = [&[], &["pages2"], &["pages2", "pages3"], &["pages2", "pages3", "pages4"]];
    assert_eq!(features("photometric/sums"), [&[][..], &["rgb"]]);
    for pass in ["confidence", "render/colour", "photometric/map"] {
        assert_eq!(features(pass), pages, "{pass}");
    }
    let kinds: [&[&str]; 4] = [&[], &["listed"], &["f32"], &["f32", "listed"]];
    let raycast = kinds.iter().flat_map(|kind| pages.map(|pages| [kind, pages].concat()));
    assert!(features("raycast").into_iter().map(<[_]>::to_vec).eq(raycast));
    assert_eq!(features("integrate").len(), 16);
    assert_eq!(features("mesh/vertices").len(), 8);
    assert_eq!(features("mesh_view").len(), 1);
}
