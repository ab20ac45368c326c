// Lists whose length is known to the device alone, divided among workgroups.

// The first entry that a workgroup goes over, and the one behind its last: they lie together, so that memory is read in order.
fn span(count: u32, group: u32, groups: u32) -> vec2<u32> {
    let each = (count + groups - 1u) / groups;
    return min(vec2(group * each, group * each + each), vec2(count));
}
