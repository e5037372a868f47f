// The innovation: the difference of the current samples from the history; see Tile::insert_current in tile.rs.

// RGB of the samples less the RGB that the history predicts there, and the confidence of the prediction.
@group(0) @binding(9) var<storage, read_write> innovation: array<vec4<f32>>;

// The history's prediction of the four pixels: Σ weight·RGB, Σ weight.
var<private> past_sum: array<vec4<f32>, 4>;

fn add_past(k: u32, is_past: bool, weighed: vec4<f32>) {
    past_sum[k] += select(vec4(0.0), weighed, is_past);
}

fn write_innovation(k: u32, at: vec2<u32>, tile_varies: bool) {
    let scale = frame.scale;
    let is_sample = all(at >= frame.first_sampled) && all((at - frame.first_sampled) % scale == vec2(0u));
    let sample = (at - frame.first_sampled) / scale;
    if !is_sample || !tile_varies || any(sample >= frame.lr) {
        return;
    }
    let i = sample.y * frame.lr.x + sample.x;
    let past = past_sum[k];
    let knows = past.w / (1.0 + past.w);
    let differs = select(vec3(0.0), surface_at(sample).sample.color - past.xyz / past.w, past.w > FAINT);
    innovation[i] = vec4(differs, knows);
}

fn begin_errors(lane: u32) {}

fn add_error(at: vec2<u32>, corner: vec2<i32>, correction: vec3<f32>) {}

fn write_errors(corner: vec2<i32>, lane: u32) {}
