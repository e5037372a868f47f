// Adds past samples to the surface of the current samples; see splat.rs and tile.rs.
//
// A workgroup makes a tile of pixels plus one pixel around it, which the correction for curvature needs. First an
// invocation evaluates the surface at four pixels in a row, which share its columns. Then an invocation adds the
// samples that reach its pixels: among those of COLUMNS cells in each of ROWS rows (order.wgsl).

// RGB and uncertainty, halves, row by row.
@group(0) @binding(7) var<storage, read_write> image: array<vec2<u32>>;

const QUADS: u32 = MADE_WIDTH / 4u;
const THREADS: u32 = QUADS * MADE_HEIGHT;
// Rows of pixels that the invocations, side by side, make at a time: a quarter of the tile's.
const LINES: u32 = THREADS / MADE_WIDTH;

// The pixels: Σ weight·RGB and Σ weight; at the end colours and uncertainties.
var<workgroup> made: array<vec4<f32>, MADE_WIDTH * MADE_HEIGHT>;
// Not 0 if there is anything but bare background of one colour. All invocations that write it at a time write the
// same.
var<workgroup> varied: u32;

@compute @workgroup_size(THREADS)
fn accumulate(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    // The first made pixel, in the image; −1 for the first tiles.
    let corner = vec2<i32>(group.xy * vec2(MADE_WIDTH - 2u, MADE_HEIGHT - 2u)) - 1;
    let last = vec2<i32>(frame.size) - 1;
    if lane == 0u {
        varied = 0u;
    }
    begin_errors(lane);

    // The surface.
    let middle = vec2<u32>(clamp(corner + vec2(i32(MADE_WIDTH), i32(MADE_HEIGHT)) / 2, vec2(0), last)) / SCALE;
    let reference = surface_at(middle).sample;
    var is_varied = !reference.is_bare;
    let quad = vec2(lane % QUADS * 4u, lane / QUADS);
    let rows = rows_around(u32(clamp(corner.y + i32(quad.y), 0, last.y)));
    let to_row = min(rows.fraction, 1.0 - rows.fraction) * f32(SCALE);
    var index = -0x7fffffff;
    var left: Column;
    var right: Column;
    for (var k = 0u; k < 4u; k++) {
        let x = u32(clamp(corner.x + i32(quad.x + k), 0, last.x));
        let place = frame.x_places[x % SCALE];
        let next = i32(place.x) + i32(x / SCALE);
        if next != index {
            index = next;
            left = column_at(index, rows, reference.color);
            right = column_at(index + 1, rows, reference.color);
        }
        let to_column = min(place.y, 1.0 - place.y) * f32(SCALE);
        let d2 = fma(to_column, to_column, to_row * to_row);
        let weight = 1.0 / (NOISE + SURFACE * d2 * d2 / (1.0 + SURFACE * d2));
        let w = hermite_weights(place.y);
        let value = left.value * w.x + left.slope * w.y + right.value * w.z + right.slope * w.w;
        made[quad.y * MADE_WIDTH + quad.x + k] = vec4(value, 1.0) * weight;
        is_varied = is_varied || !left.is_bare || !right.is_bare;
    }
    workgroupBarrier();

    // The samples.
    for (var k = 0u; k < 4u; k++) {
        let pixel = vec2(lane % MADE_WIDTH, lane / MADE_WIDTH + k * LINES);
        let to = corner + vec2<i32>(pixel);
        var sum = made[pixel.y * MADE_WIDTH + pixel.x];
        for (var r = 0; r < i32(ROWS); r++) {
            let run = run_of(to + vec2(0, r), i32(COLUMNS));
            for (var place = run.x; place < run.y; place++) {
                let d = vec2<f32>(to) - ordered_places[place];
                let a = ordered_a[place];
                // See CORNERS in splat.rs.
                if (a.x & OF_BLOCK) != 0u && any(abs(d) >= vec2(BLOCK_REACH)) {
                    continue;
                }
                let s = unpack_sample(a.y, ordered_b[place], ordered_c[place]);
                let d2 = dot(d, d);
                let weight = 1.0 / fma(d2, d2, bitcast<f32>(a.x & ~CURRENT));
                let prediction = fma(s.dx, vec3(d.x), fma(s.dy, vec3(d.y), s.color));
                let weighed = vec4(prediction, 1.0) * weight;
                sum += weighed;
                add_past(k, (a.x & CURRENT) == 0u, weighed);
                is_varied = is_varied || !s.is_bare || any(s.color != reference.color);
            }
        }
        let variance = 1.0 / sum.w;
        let uncertainty = clamp(sqrt(variance) - EXACT, 0.0, 1.0);
        made[pixel.y * MADE_WIDTH + pixel.x] = vec4(sum.xyz * variance, uncertainty);
    }
    if is_varied {
        varied = 1u;
    }
    let tile_varies = workgroupUniformLoad(&varied) != 0u;

    // Curvature.
    for (var k = 0u; k < 4u; k++) {
        let pixel = vec2<i32>(vec2(lane % MADE_WIDTH, lane / MADE_WIDTH + k * LINES));
        let to = corner + pixel;
        let is_wanted = all(pixel >= vec2(1)) && all(pixel < vec2(i32(MADE_WIDTH), i32(MADE_HEIGHT)) - 1);
        if is_wanted && all(to <= last) {
            let around = (made_at(to + vec2(0, -1), corner) + made_at(to + vec2(0, 1), corner))
                + (made_at(to + vec2(-1, 0), corner) + made_at(to + vec2(1, 0), corner));
            let here = made[u32(pixel.y) * MADE_WIDTH + u32(pixel.x)];
            let laplacian = fma(here.xyz, vec3(-4.0), around);
            let correction = laplacian * (here.w * CURVATURE);
            add_error(vec2<u32>(to), corner, select(vec3(0.0), correction, tile_varies));
            var color = fma(laplacian, vec3(here.w * CURVATURE), here.xyz);
            var uncertainty = here.w;
            if KRIGING && any(abs(color - here.xyz) > vec3(THRESHOLD)) {
                // For kriging.wgsl.
                uncertainty = -uncertainty;
            }
            if !tile_varies {
                color = reference.color;
                uncertainty = 0.0;
            }
            color = clamp(color, vec3(-LARGEST_HALF), vec3(LARGEST_HALF));
            let packed = vec2(pack2x16float(color.xy), pack2x16float(vec2(color.z, uncertainty)));
            image[u32(to.y) * frame.size.x + u32(to.x)] = packed;
            write_innovation(k, vec2<u32>(to), tile_varies);
        }
    }
    write_errors(corner, lane);
}

// The colour of the made pixel at `at` of the image; outside, of the nearest pixel in the image.
fn made_at(at: vec2<i32>, corner: vec2<i32>) -> vec3<f32> {
    let place = vec2<u32>(clamp(at, vec2(0), vec2<i32>(frame.size) - 1) - corner);
    return made[place.y * MADE_WIDTH + place.x].xyz;
}
