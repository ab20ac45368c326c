// A block's voxels with one layer of its neighbours' below and two above: 11x11x11, so that central
// differences at both ends of its edges need no look-ups.

const PADDED_SIDE: i32 = 11;
const PADDED_VOXELS: u32 = 1331u;

// Index of voxel (-1 to 9 along each axis) within a padded block.
fn padded_index(voxel: vec3<i32>) -> u32 {
    let v = voxel + vec3(1);
    return u32(v.x + PADDED_SIDE * (v.y + PADDED_SIDE * v.z));
}

// Which of the 27 blocks around a voxel lies in, each axis counted -1, 0, 1 from the block itself.
fn neighbour_index(offset: vec3<i32>) -> u32 {
    let o = offset + vec3(1);
    return u32(o.x + 3 * (o.y + 3 * o.z));
}
