// Marks the blocks that the frame's depth asks for and that are not there yet: for each pixel those that the ray crosses
// between d - mu and d + mu (the report, section 3.2; Nießner et al. 2013, section 5.1), one bit a grid cell.
import package::shared::camera::{Camera, unproject};
import package::shared::map::{Map, OUTSIDE, cell_of};

struct Params {
    camera: Camera,
    world_from_camera: mat4x4<f32>,
    map: Map,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> depth: array<f32>;
@group(0) @binding(2) var<storage, read> cells: array<u32>;
@group(0) @binding(3) var<storage, read_write> requests: array<atomic<u32>>;

fn request(block: vec3<i32>) {
    let cell = cell_of(params.map, block);
    if cell == OUTSIDE || cells[cell] != 0u {
        return;
    }
    let bit = 1u << (cell & 31u);
    // A load is cheaper than an atomic or, and most pixels find their block asked for already.
    if (atomicLoad(&requests[cell >> 5u]) & bit) == 0u {
        atomicOr(&requests[cell >> 5u], bit);
    }
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let size = params.camera.size;
    if id.x >= size.x || id.y >= size.y {
        return;
    }
    let z = depth[id.y * size.x + id.x];
    if z <= 0.0 {
        return;
    }
    let ray = unproject(params.camera, vec2<f32>(id.xy), 1.0);
    let reach = params.map.truncation_m / length(ray);
    let blocks_per_m = 1.0 / (8.0 * params.map.voxel_size_m);
    let near = (params.world_from_camera * vec4(ray * max(z - reach, 0.0), 1.0)).xyz * blocks_per_m;
    let far = (params.world_from_camera * vec4(ray * (z + reach), 1.0)).xyz * blocks_per_m;

    // Amanatides & Woo 1987, from the near point's block to the far one's.
    let step_vector = far - near;
    var block = vec3<i32>(floor(near));
    let last = vec3<i32>(floor(far));
    let forward = step_vector > vec3(0.0);
    let direction = select(vec3(-1), vec3(1), forward);
    let inverse = 1.0 / select(step_vector, vec3(1e-12), abs(step_vector) < vec3(1e-12));
    let per_block = abs(inverse);
    var next = (select(floor(near), floor(near) + vec3(1.0), forward) - near) * inverse;
    // Each step goes one block nearer to the last one along one axis, so their number is known.
    let distance = abs(last - block);
    let steps = distance.x + distance.y + distance.z;
    request(block);
    for (var i = 0; i < steps; i++) {
        // An axis that has arrived takes no more steps, whatever rounding says.
        let open = select(vec3(3e38), next, block != last);
        if open.x <= open.y && open.x <= open.z {
            block.x += direction.x;
            next.x += per_block.x;
        } else if open.y <= open.z {
            block.y += direction.y;
            next.y += per_block.y;
        } else {
            block.z += direction.z;
            next.z += per_block.z;
        }
        request(block);
    }
}
