//! Numbers in WGSL without an explanation, for tests.

/// The literals of a WGSL file that need an explanation and have none, each as "line N: LITERAL in `code`".
///
/// Numbers that Rust has too are written in Rust only, and come into the WGSL by `gs3_compute::constants`. The
/// rules for the others:
///
/// * `//` begins a comment, which is not code. (There are no `/* */` comments.)
/// * Integers are free: they are indices, masks and shifts. (WGSL also takes them as floats; the rule does not see that.) Only an argument of `@workgroup_size` must be 1 or a name,
///   because Rust counts workgroups by it.
/// * Floats are free if they are whole numbers up to 64, 0.5 or 0.25: factors of formulas.
/// * All other floats stand in a declaration (`const` or `override`) with a comment: on the line where the declaration
///   begins, on the line above, or on the literal's own line.
///
/// `source` is the text of a file, not a module that is put together: constants from Rust have their reasons in Rust.
fn unexplained_literals(source: &str) -> Vec<String> {
    let mut found = Vec::new();
    // Whether the declaration that is open has a comment; none outside of declarations.
    let mut declaration: Option<bool> = None;
    // The tokens of an argument of `@workgroup_size`; none outside of its arguments.
    let mut argument: Option<Vec<&str>> = None;
    let mut is_below_comment = false;
    for (number, line) in (1_usize..).zip(source.lines()) {
        let (code, has_comment) = match line.split_once("//") {
            Some((code, _)) => (code, true),
            None => (line, false),
        };
        let mut report = |literal: &str| found.push(format!("line {number}: {literal} in `{}`", line.trim()));
        let mut before = "";
        for token in tokens(code) {
            if let Some(parts) = &mut argument {
                match token {
                    "(" => {}
                    "," | ")" => {
                        if !is_workgroup_size(parts) {
                            report(&parts.concat());
                        }
                        argument = if token == "," { Some(Vec::new()) } else { None };
                    }
                    _ => parts.push(token),
                }
            } else if token == "workgroup_size" && before == "@" {
                argument = Some(Vec::new());
            } else if token == "const" || token == "override" {
                declaration = Some(has_comment || is_below_comment);
            } else if token == ";" {
                declaration = None;
            } else if is_float(token) && !is_free(token) {
                let is_explained = declaration.is_some_and(|is_commented| is_commented || has_comment);
                if !is_explained {
                    report(token);
                }
            }
            before = token;
        }
        is_below_comment = has_comment && code.trim().is_empty();
    }
    found
}

/// Checks that the literals of all WGSL files of `folder` are explained, and returns the number of files.
///
/// # Panics
/// If a file has unexplained literals, or cannot be read.
pub fn check_literals(folder: &str) -> usize {
    let entries = std::fs::read_dir(folder).unwrap_or_else(|error| panic!("{folder}: {error}"));
    let mut files = 0;
    for entry in entries {
        let path = entry.unwrap_or_else(|error| panic!("{folder}: {error}")).path();
        if path.extension().is_some_and(|ending| ending == "wgsl") {
            let source = std::fs::read_to_string(&path);
            let source = source.unwrap_or_else(|error| panic!("{}: {error}", path.display()));
            let found = unexplained_literals(&source);
            assert!(found.is_empty(), "{}:\n{}", path.display(), found.join("\n"));
            files += 1;
        }
    }
    files
}

/// Words, numbers and single signs.
fn tokens(code: &str) -> impl Iterator<Item = &str> {
    let mut rest = code.trim_start();
    std::iter::from_fn(move || {
        let (token, after) = rest.split_at(token_len(rest));
        rest = after.trim_start();
        (!token.is_empty()).then_some(token)
    })
}

/// Bytes of the first token of `code`.
fn token_len(code: &str) -> usize {
    let bytes = code.as_bytes();
    match bytes {
        [b'0'..=b'9', ..] | [b'.', b'0'..=b'9', ..] => number_len(bytes),
        [b'a'..=b'z' | b'A'..=b'Z' | b'_', ..] => {
            let end = bytes.iter().position(|byte| !(byte.is_ascii_alphanumeric() || *byte == b'_'));
            end.unwrap_or(bytes.len())
        }
        _ => code.chars().next().map_or(0, char::len_utf8),
    }
}

/// Bytes of the number that `code` begins with, with its suffix.
fn number_len(code: &[u8]) -> usize {
    let exponent = if is_hexadecimal(code) { b'p' } else { b'e' };
    let mut before = 0;
    let end = code.iter().position(|byte| {
        let is_sign = matches!(byte, b'+' | b'-') && exponent.eq_ignore_ascii_case(&before);
        before = *byte;
        !(is_sign || byte.is_ascii_alphanumeric() || *byte == b'.')
    });
    end.unwrap_or(code.len())
}

fn is_hexadecimal(number: &[u8]) -> bool {
    matches!(number, [b'0', b'x' | b'X', ..])
}

fn is_number(token: &str) -> bool {
    matches!(token.as_bytes(), [b'0'..=b'9', ..] | [b'.', b'0'..=b'9', ..])
}

fn is_float(token: &str) -> bool {
    // In hexadecimal numbers e and f are digits.
    let of_floats = if is_hexadecimal(token.as_bytes()) { ".pP" } else { ".eEfh" };
    is_number(token) && token.contains(|sign: char| of_floats.contains(sign))
}

/// Whether a float is of those that formulas have.
fn is_free(float: &str) -> bool {
    let value = float.trim_end_matches(['f', 'h']).parse::<f64>();
    value.is_ok_and(|value| value == 0.5 || value == 0.25 || (value.fract() == 0.0 && value <= 64.0))
}

/// Whether an argument of `@workgroup_size` is 1 or a name; `parts` are its tokens.
fn is_workgroup_size(parts: &[&str]) -> bool {
    match parts {
        // After the last comma.
        [] => true,
        [part] => !is_number(part) || matches!(*part, "1" | "1u" | "1i"),
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn explained_numbers_pass() {
        let source = "
            // Not code: 0.3, @workgroup_size(64).
            const MASK: u32 = 0x1e5fu & (1u << 30u); // 0.7
            // As many as a wave has.
            const NEAR: f32 = 1e-3;
            const FAR: f32 = 1.5e+3f; // World units.
            @id(0) override SHARE: f32 = 0.3; // Of the screen.
            // A line of several lines.
            const LINE = vec4<f32>(
                0.1, 0.2,
                0.3, 0.4,
            );
            const NAMES = array<f32, 2>(
                0.1, // Yellow.
                1.0
            );
            var<workgroup> seen: array<vec4<f32>, 256>;
            @compute @workgroup_size(WIDTH, HEIGHT, 1)
            fn main(@builtin(local_invocation_index) lane: u32) {
                let c2_5 = 3.0 * x.xy - 0.5 + .25 / 35.0f + 64. * 1e1;
                let mask = lane & 0xffffu | 1000u >> 3u;
            }
            @compute @workgroup_size(
                THREADS,
            )
            fn other() {}";
        assert_eq!(unexplained_literals(source), Vec::<String>::new());
    }

    #[test]
    fn floats_need_a_declaration_with_a_comment() {
        let found = unexplained_literals;
        assert_eq!(found("\nlet a = 0.1 * b;"), ["line 2: 0.1 in `let a = 0.1 * b;`"]);
        // A comment alone is not enough: the number has no name.
        assert_eq!(
            found("// Empirical.\nlet a = b - 1e-5; // Small."),
            ["line 2: 1e-5 in `let a = b - 1e-5; // Small.`"]
        );
        // Nor is a name.
        assert_eq!(found("const A: f32 = 255.0;"), ["line 1: 255.0 in `const A: f32 = 255.0;`"]);
        // An explanation is of one declaration.
        assert_eq!(
            found("// Both.\nconst A = 1e20;\nconst B = 1e30;"),
            ["line 3: 1e30 in `const B = 1e30;`"]
        );
        assert_eq!(found("// It.\n\nconst A = 0.1f;"), ["line 3: 0.1f in `const A = 0.1f;`"]);
        // A declaration ends.
        assert_eq!(
            found("const A = 1u; let b = 3.5; // One."),
            ["line 1: 3.5 in `const A = 1u; let b = 3.5; // One.`"]
        );
    }

    #[test]
    fn floats_that_are_free_are_few() {
        for free in ["0.0", "1.0", "2.0f", "64.0", "0.5", "0.25h", "12f", "1e1", "0x1f", "4096u", "7i"] {
            assert_eq!(unexplained_literals(&format!("let a = {free};")), Vec::<String>::new(), "{free}");
        }
        for other in ["65.0", "0.125", "1.5", "1e-4", "3.4e38", "2E+8f", "300f", ".75", "0x1.8p3", "0x1p-4"] {
            let expected = format!("line 1: {other} in `let a = b-{other}+c;`");
            assert_eq!(unexplained_literals(&format!("let a = b-{other}+c;")), [expected], "{other}");
        }
    }

    #[test]
    fn sizes_of_workgroups_have_names() {
        let sized = |arguments: &str| format!("@compute @workgroup_size({arguments}) fn main() {{}}");
        for named in ["THREADS", "1", "1u", "X, Y", "X, 1, 1u", "X, Y,"] {
            assert_eq!(unexplained_literals(&sized(named)), Vec::<String>::new(), "{named}");
        }
        for (written, literals) in [
            ("64", vec!["64"]),
            ("64u, Y", vec!["64u"]),
            ("X, 2", vec!["2"]),
            ("8, 4, 1", vec!["8", "4"]),
            ("2u * X", vec!["2u*X"]),
        ] {
            let source = sized(written);
            let expected: Vec<String> =
                literals.iter().map(|literal| format!("line 1: {literal} in `{source}`")).collect();
            assert_eq!(unexplained_literals(&source), expected, "{written}");
        }
    }
}
