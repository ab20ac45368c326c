//! `itm devices`.

use anyhow::Result;
use clap::Args;
use itm_slam::{AdapterReport, Device};
use serde_json::json;

use crate::console;

/// List the adapters that can compute: kind, backend, driver, limits, and how large a map fits
#[derive(Args)]
pub(crate) struct Arguments {
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Bytes of a block: 512 voxels with a word of distance and one of colour.
const BLOCK_BYTES: u64 = 512 * (4 + 4);
/// Edge of a block at the default voxel size, in metres.
const BLOCK_EDGE_M: f64 = 8.0 * 0.005;
/// Blocks of a surface patch as large as a block's face: a band of one block's thickness, at any angle to the grid,
/// touches two to three.
const BLOCKS_A_FACE: f64 = 3.0;

pub(crate) fn run(arguments: &Arguments) -> Result<u8> {
    let adapters = Device::adapters();
    if adapters.is_empty() {
        // Its error says what to install.
        Device::open("auto")?;
    }
    let chosen = adapters.iter().position(|adapter| adapter.unfit.is_none());
    if arguments.json {
        let list: Vec<_> = adapters.iter().enumerate().map(|(i, a)| as_json(i, a, chosen == Some(i))).collect();
        console::print_json(&list)?;
    } else {
        for (i, adapter) in adapters.iter().enumerate() {
            console::print(as_text(i, adapter, chosen == Some(i)))?;
        }
        console::print("\nChoose with --device NUMBER or a part of the name; 'auto' takes the one marked *.")?;
    }
    Ok(0)
}

/// Square metres of surface that so many blocks hold at the default voxel size, roughly.
fn surface_m2(blocks: u64) -> f64 {
    blocks as f64 * BLOCK_EDGE_M * BLOCK_EDGE_M / BLOCKS_A_FACE
}

fn as_text(number: usize, adapter: &AdapterReport, chosen: bool) -> String {
    let AdapterReport { name, kind, backend, driver, max_binding_bytes, max_storage_buffers, max_workgroup, .. } =
        adapter;
    let mark = if chosen { '*' } else { ' ' };
    let fit = match &adapter.unfit {
        Some(reason) => format!("cannot be used: {reason}"),
        None => format!(
            "largest map {} blocks, {:.1} GiB: about {:.0} m² of surface at 5 mm",
            adapter.max_blocks,
            gib(adapter.max_blocks * BLOCK_BYTES),
            surface_m2(adapter.max_blocks),
        ),
    };
    let clock = if adapter.timestamps { "stages are timed on the device" } else { "no clock on the device" };
    format!(
        "{mark} {number}: {name}\n     {kind}, {backend}, {driver}\n     buffers up to {:.2} GiB, {max_storage_buffers} in a shader; \
         workgroups up to {max_workgroup}; {clock}\n     {fit}",
        gib(*max_binding_bytes),
    )
}

fn as_json(number: usize, adapter: &AdapterReport, chosen: bool) -> serde_json::Value {
    json!({
        "number": number,
        "auto": chosen,
        "name": adapter.name,
        "kind": adapter.kind.to_string(),
        "backend": adapter.backend,
        "driver": adapter.driver,
        "max_binding_bytes": adapter.max_binding_bytes,
        "max_storage_buffers": adapter.max_storage_buffers,
        "max_workgroup": adapter.max_workgroup,
        "timestamps": adapter.timestamps,
        "max_blocks": adapter.max_blocks,
        "unfit": adapter.unfit,
    })
}

fn gib(bytes: u64) -> f64 {
    bytes as f64 / f64::from(1 << 30)
}
