// Mesh vertices lie on the lattice's edges. Each voxel owns the three edges that leave it along +x, +y, +z. For a block,
// 48 words hold one bit for each of its 3 x 512 edges (axis by axis, voxels in their order), then six words how many
// bits are set before each group of eight.

const EDGE_WORDS: u32 = 48u;
const EDGE_GROUPS: u32 = 6u;
const EDGE_STRIDE: u32 = 54u;

// Cube edge e runs along axis e / 4 from this corner.
fn edge_start(e: u32) -> vec3<i32> {
    let a = i32(e & 1u);
    let b = i32((e >> 1u) & 1u);
    switch e >> 2u {
        case 0u: { return vec3(0, a, b); }
        case 1u: { return vec3(a, 0, b); }
        default: { return vec3(a, b, 0); }
    }
}
