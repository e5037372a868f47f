// Four pixels in a row of the image per invocation, each WORDS words. What is in capitals is written out by export.rs.
@compute @workgroup_size(THREADS)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) index: u32) {
    let at = group_index(group) * THREADS + index;
    let quads = (WIDTH + 3u) / 4u;
    if at >= quads * HEIGHT {
        return;
    }
    let x = at % quads * 4u;
    let y = at / quads;
    ROWS
    let first = (y * WIDTH + x) * WORDS;
    STORES
}
