// Which blocks a view reaches.
import package::shared::map::{Map, unpack_position};

struct Frustum {
    camera_from_world: mat4x4<f32>,
    // Inward unit normals of the four sides, through the camera's centre (camera frame).
    sides: array<vec4<f32>, 4>,
    near_m: f32,
    far_m: f32,
    // Blocks this far outside count too.
    margin_m: f32,
    unused: f32,
}

// Whether the sphere around a block's 8x8x8 voxels reaches into the frustum, or into its margin.
fn is_within(map: Map, frustum: Frustum, key: vec2<u32>) -> bool {
    if (key.y >> 16u) != map.submap {
        return false;
    }
    let centre = (vec3<f32>(unpack_position(key)) * 8.0 + 3.5) * map.voxel_size_m;
    let p = (frustum.camera_from_world * vec4(centre, 1.0)).xyz;
    let radius = 3.5 * 1.7320509 * map.voxel_size_m + frustum.margin_m;
    if p.z + radius < frustum.near_m || p.z - radius > frustum.far_m {
        return false;
    }
    for (var i = 0; i < 4; i++) {
        if dot(frustum.sides[i].xyz, p) < -radius {
            return false;
        }
    }
    return true;
}
