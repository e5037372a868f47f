fn halves(a: f32, b: f32) -> u32 {
    return pack2x16float(clamp(vec2(a, b), vec2(-LARGEST_HALF), vec2(LARGEST_HALF)));
}
