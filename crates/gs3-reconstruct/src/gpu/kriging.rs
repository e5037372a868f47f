//! Generated lines of `kriging.wgsl`: rows in registers need indices that do not depend on loops.

use crate::cpu::kriging::SAMPLES;

/// Vectors of a row of a system, without the vector of the right-hand side.
const ROW: usize = 3 * SAMPLES / 4;

/// Invocations of a workgroup: pixels examined at a time.
pub const THREADS: usize = 64;

/// The rows of a sample: value and derivatives.
const DATA: [&str; 3] = ["value", "dx", "dy"];

/// Vectors of a row, with the right-hand side.
pub const WIDTH: usize = ROW + 1;

/// Fills the rows of an invocation's sample: covariances with all samples.
pub fn fill() -> String {
    let mut text = String::new();
    for j in 0..SAMPLES {
        text += &format!(
            "let with{j} = shared_by(here, around[first + {j}u], select(0.0, own, sample == {j}u));\n    "
        );
    }
    for data in DATA {
        // Four samples have twelve numbers: three vectors.
        for (v, j) in (0..SAMPLES).step_by(4).map(|j| (3 * j / 4, j)) {
            let of = |k: usize| format!("with{}.{data}", j + k);
            let vectors = [
                format!("{}, {}.x", of(0), of(1)),
                format!("{}.yz, {}.xy", of(1), of(2)),
                format!("{}.z, {}", of(2), of(3)),
            ];
            for (k, vector) in vectors.iter().enumerate() {
                text += &format!("var {data}{} = vec4({vector});\n    ", v + k);
            }
        }
    }
    text
}

/// Eliminates: sample after sample shares its rows, and all other samples subtract them from theirs.
pub fn eliminate() -> String {
    let mut text = String::new();
    for i in 0..SAMPLES {
        // Two places alternate: reads of one place are finished when all have written the other.
        let place = format!("({}u + system) * {}u", i % 2 * (THREADS / SAMPLES), 3 * WIDTH);
        let vectors: Vec<usize> = (3 * i / 4..WIDTH).collect();
        text += &format!("if sample == {i}u {{\n");
        for (r, data) in DATA.iter().enumerate() {
            for v in &vectors {
                text += &format!("pivots[{place} + {}u] = {data}{v};\n", r * WIDTH + v);
            }
        }
        text += "}\nworkgroupBarrier();\n{\n";
        for r in 0..DATA.len() {
            for v in &vectors {
                text += &format!("let p{r}_{v} = pivots[{place} + {}u];\n", r * WIDTH + v);
            }
        }
        let of = |row: &str, separator: &str, k: usize| {
            let column = 3 * i + k;
            format!("{row}{separator}{}[{}]", column / 4, column % 4)
        };
        let [a, b, c] = ["p0", "p1", "p2"];
        text += &format!(
            "let f = factors_of(vec3({}, {}, {}), vec2({}, {}), {});\n",
            of(a, "_", 0),
            of(a, "_", 1),
            of(a, "_", 2),
            of(b, "_", 1),
            of(b, "_", 2),
            of(c, "_", 2)
        );
        text += &format!(
            "let y = solved(f, vec3(p0_{ROW}.x, p1_{ROW}.x, p2_{ROW}.x));
all += p0_{ROW} * y.x + p1_{ROW} * y.y + p2_{ROW} * y.z;\n"
        );
        if i + 1 < SAMPLES {
            for data in DATA {
                let own = [0, 1, 2].map(|k| of(data, "", k)).join(", ");
                text += &format!("let by_{data} = solved(f, vec3({own}));\n");
                for v in 3 * (i + 1) / 4..WIDTH {
                    text += &format!(
                        "{data}{v} -= p0_{v} * by_{data}.x + p1_{v} * by_{data}.y + p2_{v} * by_{data}.z;\n"
                    );
                }
            }
        }
        text += "}\n";
    }
    text
}
