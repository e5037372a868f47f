// Adds past samples to the surface of the current samples; see splat.rs and tile.rs.
//
// A workgroup makes a tile of pixels plus one pixel around it, which the correction for curvature needs. An
// invocation makes four pixels in a row. The lists of the samples that reach the tile are sorted by cell, and within
// a cell by the samples' numbers, so that sums do not depend on the order of arrival. Then a window of whole cells,
// as many samples as fit, is loaded into workgroup memory at a time. Every invocation adds the samples of the cells
// that reach its pixels, seven cells in each of three rows: three runs of consecutive samples.

@group(0) @binding(5) var<storage, read> heads: array<u32>;
@group(0) @binding(6) var<storage, read> places: array<vec2<f32>>;
@group(0) @binding(7) var<storage, read> links: array<vec2<u32>>;
// RGB and uncertainty, halves, row by row.
@group(0) @binding(8) var<storage, read_write> image: array<vec2<u32>>;

const QUADS: u32 = MADE_WIDTH / 4u;
const THREADS: u32 = QUADS * MADE_HEIGHT;
const CELLS_X: u32 = MADE_WIDTH + COLUMNS - 1u;
const CELLS: u32 = CELLS_X * (MADE_HEIGHT + ROWS - 1u);
// Number of cells with lists that one invocation sorts.
const OWN: u32 = (CELLS + THREADS - 1u) / THREADS;

// Number of samples before each cell; the last entry is the total.
var<workgroup> starts: array<u32, CELLS + 1u>;
var<workgroup> sums: array<u32, THREADS>;
// Numbers of the samples in memory.
var<workgroup> order: array<u32, CAPACITY>;
// The samples: position in the tile, variance, and five words of colour and gradient. The first halves of all samples
// come before the second halves. After every eight samples one place stays empty: neighbouring invocations read
// samples four cells apart, which at rest are four places apart, and would otherwise wait for the same banks. At the
// end, this memory holds the pixels.
const HALF: u32 = CAPACITY + CAPACITY / 8u;
var<workgroup> staged: array<vec4<u32>, 2u * HALF>;

// The place of the first half of a sample.
fn place_of(slot: u32) -> u32 {
    return slot + slot / 8u;
}
var<workgroup> window_end: u32;
// Not 0 if there is anything but bare background of one colour. All invocations that write it at a time write the
// same.
var<workgroup> varied: u32;

// The list of cell `c` of the tile with the first made pixel `corner`.
fn head_of(c: u32, corner: vec2<i32>) -> u32 {
    let at = corner + vec2<i32>(vec2(c % CELLS_X, c / CELLS_X));
    let size = vec2<i32>(frame.size) + vec2(i32(COLUMNS) - 1, i32(ROWS) - 1);
    if any(at < vec2(0)) || any(at >= size) {
        return 0u;
    }
    return heads[u32(at.y * size.x + at.x)];
}

// The end of the window of cells that begins at `first`: as many cells as fit, at least one.
fn end_of_window(first: u32) -> u32 {
    var low = first + 1u;
    var high = CELLS;
    while low < high {
        let mid = (low + high + 1u) / 2u;
        if starts[mid] - starts[first] <= CAPACITY {
            low = mid;
        } else {
            high = mid - 1u;
        }
    }
    return low;
}

// Writes the list of cell `c` to `order` from place `base` on, smallest number first. If there are more than `room`,
// the smallest stay; this needs a camera that moves away from the scene very fast.
fn put_in_order(c: u32, corner: vec2<i32>, base: u32, room: u32) {
    var count = 0u;
    for (var id = head_of(c, corner); id != 0u; id = links[id - 1u].y) {
        var k = count;
        if count < room {
            count++;
        } else if order[base + room - 1u] < id {
            continue;
        } else {
            k = room - 1u;
        }
        while k > 0u && order[base + k - 1u] > id {
            order[base + k] = order[base + k - 1u];
            k--;
        }
        order[base + k] = id;
    }
}

// In the variance's sign: the sample belongs to the current frame.
const CURRENT: u32 = 0x80000000u;

// Four pixels in a row: Σ weight·RGB, Σ weight.
var<private> sum: array<vec4<f32>, 4>;

// Adds the samples in places `first..end`. The first pixel is `pixel` in the tile.
fn add_run(first: u32, end: u32, pixel: vec2<f32>) {
    for (var slot = first; slot < end; slot++) {
        let a = staged[place_of(slot)];
        let b = staged[HALF + place_of(slot)];
        let at = bitcast<vec2<f32>>(a.xy);
        let noise = bitcast<f32>(a.z & 0x7fffffffu);
        let is_past = (a.z & CURRENT) == 0u;
        let s = unpack_sample(a.w, b.xy, b.zw);
        let d = pixel - at;
        let reaches = pixel.x - (floor(at.x) - 1.0);
        var prediction = fma(s.dx, vec3(d.x), fma(s.dy, vec3(d.y), s.color));
        for (var k = 0u; k < 4u; k++) {
            let dx = d.x + f32(k);
            let d2 = fma(d.y, d.y, dx * dx);
            let column = reaches + f32(k);
            let weight = select(0.0, 1.0 / fma(d2, d2, noise), column >= 0.0 && column < f32(COLUMNS));
            let weighed = vec4(prediction, 1.0) * weight;
            sum[k] += weighed;
            add_past(k, is_past, weighed);
            prediction += s.dx;
        }
    }
}

@compute @workgroup_size(THREADS)
fn accumulate(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    // The first made pixel, in the image; −1 for the first tiles.
    let corner = vec2<i32>(group.xy * vec2(MADE_WIDTH - 2u, MADE_HEIGHT - 2u)) - 1;
    let last = vec2<i32>(frame.size) - 1;
    let pixel = vec2(lane % QUADS * 4u, lane / QUADS);

    // Number of samples in each cell, and before it.
    var own = 0u;
    for (var k = 0u; k < OWN; k++) {
        let c = lane * OWN + k;
        if c < CELLS {
            var count = 0u;
            for (var id = head_of(c, corner); id != 0u; id = links[id - 1u].y) {
                count++;
            }
            count = min(count, CAPACITY);
            starts[c] = count;
            own += count;
        }
    }
    sums[lane] = own;
    if lane == 0u {
        varied = 0u;
    }
    workgroupBarrier();
    for (var step = 1u; step < THREADS; step *= 2u) {
        var before = 0u;
        if lane >= step {
            before = sums[lane - step];
        }
        workgroupBarrier();
        sums[lane] += before;
        workgroupBarrier();
    }
    var at = sums[lane] - own;
    for (var k = 0u; k < OWN; k++) {
        let c = lane * OWN + k;
        if c < CELLS {
            let count = starts[c];
            starts[c] = at;
            at += count;
        }
    }
    if lane == THREADS - 1u {
        starts[CELLS] = at;
    }

    // The surface.
    let middle = vec2<u32>(clamp(corner + vec2(i32(MADE_WIDTH), i32(MADE_HEIGHT)) / 2, vec2(0), last)) / SCALE;
    let reference = sample_at(middle);
    var is_varied = !reference.is_bare;
    let rows = rows_around(u32(clamp(corner.y + i32(pixel.y), 0, last.y)));
    let to_row = min(rows.fraction, 1.0 - rows.fraction) * f32(SCALE);
    var index = -0x7fffffff;
    var left: Column;
    var right: Column;
    for (var k = 0u; k < 4u; k++) {
        let x = u32(clamp(corner.x + i32(pixel.x + k), 0, last.x));
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
        sum[k] = vec4(value, 1.0) * weight;
        is_varied = is_varied || !left.is_bare || !right.is_bare;
    }

    // The samples.
    for (var first = 0u; first < CELLS;) {
        // All invocations have used the samples in memory.
        workgroupBarrier();
        if lane == 0u {
            window_end = end_of_window(first);
        }
        let end = workgroupUniformLoad(&window_end);
        let base = starts[first];
        let count = starts[end] - base;
        for (var c = max(lane * OWN, first); c < min((lane + 1u) * OWN, end); c++) {
            put_in_order(c, corner, starts[c] - base, starts[c + 1u] - starts[c]);
        }
        workgroupBarrier();
        for (var slot = lane; slot < count; slot += THREADS) {
            let id = order[slot] - 1u;
            let red_green = samples_a[id].y;
            let b = samples_b[id];
            let c = samples_c[id];
            let to = places[id] - vec2<f32>(corner);
            let is_current = id - newest() < frame.padded.x * frame.padded.y;
            let noise = links[id].x | select(0u, CURRENT, is_current);
            staged[place_of(slot)] = vec4(bitcast<vec2<u32>>(to), noise, red_green);
            staged[HALF + place_of(slot)] = vec4(b, c);
            let s = unpack_sample(red_green, b, c);
            is_varied = is_varied || !s.is_bare || any(s.color != reference.color);
        }
        workgroupBarrier();
        for (var r = 0u; r < ROWS; r++) {
            let c = (pixel.y + r) * CELLS_X + pixel.x;
            let from_cell = clamp(c, first, end);
            let to_cell = clamp(c + COLUMNS + 3u, first, end);
            add_run(starts[from_cell] - base, starts[to_cell] - base, vec2<f32>(pixel));
        }
        first = end;
    }
    if is_varied {
        varied = 1u;
    }
    let tile_varies = workgroupUniformLoad(&varied) != 0u;

    // Colours and uncertainties, and their neighbours.
    for (var k = 0u; k < 4u; k++) {
        let variance = 1.0 / sum[k].w;
        let uncertainty = clamp(sqrt(variance) - EXACT, 0.0, 1.0);
        sum[k] = vec4(sum[k].xyz * variance, uncertainty);
        staged[pixel.y * MADE_WIDTH + pixel.x + k] = bitcast<vec4<u32>>(sum[k]);
    }
    workgroupBarrier();
    for (var k = 0u; k < 4u; k++) {
        let made = vec2<i32>(pixel) + vec2(i32(k), 0);
        let to = corner + made;
        let is_wanted = all(made >= vec2(1)) && all(made < vec2(i32(MADE_WIDTH), i32(MADE_HEIGHT)) - 1);
        if is_wanted && all(to <= last) {
            let around = (made_at(to + vec2(0, -1), corner) + made_at(to + vec2(0, 1), corner))
                + (made_at(to + vec2(-1, 0), corner) + made_at(to + vec2(1, 0), corner));
            let here = sum[k];
            let laplacian = fma(here.xyz, vec3(-4.0), around);
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
            color = clamp(color, vec3(-65504.0), vec3(65504.0));
            let packed = vec2(pack2x16float(color.xy), pack2x16float(vec2(color.z, uncertainty)));
            image[u32(to.y) * frame.size.x + u32(to.x)] = packed;
            write_innovation(k, vec2<u32>(to), tile_varies);
        }
    }
}

// The colour of the made pixel at `at` of the image; outside, of the nearest pixel in the image.
fn made_at(at: vec2<i32>, corner: vec2<i32>) -> vec3<f32> {
    let made = vec2<u32>(clamp(at, vec2(0), vec2<i32>(frame.size) - 1) - corner);
    return bitcast<vec3<f32>>(staged[made.y * MADE_WIDTH + made.x].xyz);
}
