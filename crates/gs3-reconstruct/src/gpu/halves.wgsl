// The largest half.
const MOST: f32 = 65504.0;

fn halves(a: f32, b: f32) -> u32 {
    return pack2x16float(clamp(vec2(a, b), vec2(-MOST), vec2(MOST)));
}
