//! Generated lines of `blend.wgsl`.

/// Splats that a pixel visits at a time: while one waits for memory or for its exponential, the other does not. (On an
/// H100 two take a tenth less time than one; four are alike.)
const AT_A_TIME: usize = 2;

/// Adds the next splats of `bits` to a pixel, front to back.
pub fn splats() -> String {
    let mut text = String::new();
    for k in 0..AT_A_TIME {
        text += &format!(
            "let is_there{k} = bits != 0u;
let slot{k} = select(0u, word * 32u + firstTrailingBit(bits), is_there{k});
bits &= bits - 1u;
let s{k} = splat_of(staged_a[slot{k}], staged_b[slot{k}]);
let d{k} = s{k}.mean - sample;
let u{k} = fma(s{k}.l11, d{k}.x, s{k}.l21 * d{k}.y);
let v{k} = s{k}.l22 * d{k}.y;
let q{k} = fma(u{k}, u{k}, v{k} * v{k});
let c{k} = staged_c[slot{k}];
let raw{k} = select(0.0, c{k}.w * exp2(-q{k}), is_there{k} && q{k} <= s{k}.support);
"
        );
    }
    for k in 0..AT_A_TIME {
        // The derivatives of α vanish where α is capped.
        text += &format!(
            "if raw{k} >= MIN_ALPHA {{
    let alpha = min(raw{k}, MAX_ALPHA);
    let after = t * (1.0 - alpha);
    if after < MIN_TRANSMITTANCE {{
        last = t;
        t = 0.0;
        break;
    }}
    let slope = select(0.0, alpha * UNSCALE, raw{k} < MAX_ALPHA);
    let weight = alpha * t;
    color = fma(c{k}.xyz, vec3(weight), color);
    add_outputs(slot{k}, s{k}, c{k}.xyz, Contribution(d{k}, u{k}, v{k}, slope, alpha, t, weight));
    t = after;
}}
"
        );
    }
    text
}
