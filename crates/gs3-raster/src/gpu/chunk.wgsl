// Whether a chunk may touch the image; see chunk.rs.

fn may_see(chunk: Chunk) -> bool {
    let center = rotate(chunk.center - view.origin);
    let slack = CHUNK_SLACK * (abs(center.x) + abs(center.y) + abs(center.z) + chunk.radius);
    let radius = chunk.radius + slack;
    if center.z + radius <= view.near {
        return false;
    }
    for (var k = 0u; k < 4u; k++) {
        let plane = view.frustum[k];
        let coordinate = select(center.y, center.x, k < 2u);
        // A chunk with non-finite bounds counts as visible.
        if plane.x * coordinate + plane.y * center.z - plane.z * radius > plane.w * chunk.largest_scale {
            return false;
        }
    }
    return true;
}
