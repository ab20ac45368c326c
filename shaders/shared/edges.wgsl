// Mesh vertices lie on the lattice's edges. Each voxel owns the three edges that leave it along +x, +y, +z. For a block,
// 48 words hold one bit for each of its 512 x 3 edges, then six words how many bits are set before each group of eight.

const EDGE_WORDS: u32 = 48u;
const EDGE_GROUPS: u32 = 6u;
const EDGE_STRIDE: u32 = 54u;

// Cube corner c lies at (c & 1, (c >> 1) & 1, c >> 2).
fn corner(c: u32) -> vec3<i32> {
    return vec3<i32>(vec3(c & 1u, (c >> 1u) & 1u, (c >> 2u) & 1u));
}

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
