//! run.sh, which starts the measurement, or says why the programs do not start.

/// What starts the measurement, but for the C library that the programs need.
const RUN: &str = include_str!("run.sh");
const GLIBC: &str = "@GLIBC@";

/// The newest version of the GNU C library, major and minor, that symbols of a `program` ask for.
pub fn newest_glibc(program: &[u8]) -> Option<(u32, u32)> {
    const PREFIX: &[u8] = b"GLIBC_";
    let versions = program.windows(PREFIX.len()).enumerate().filter(|(_, window)| *window == PREFIX);
    let version = |at: usize| {
        let digits =
            program[at + PREFIX.len()..].iter().take(16).take_while(|b| b.is_ascii_digit() || **b == b'.');
        let text: String = digits.map(|byte| char::from(*byte)).collect();
        let mut numbers = text.split('.').map(str::parse);
        Some((numbers.next()?.ok()?, numbers.next()?.ok()?))
    };
    versions.filter_map(|(at, _)| version(at)).max()
}

/// The script for programs that need `glibc`.
pub fn text(glibc: Option<(u32, u32)>) -> String {
    let needed = glibc.map_or_else(
        || "the C library of the machine that built it".to_owned(),
        |(major, minor)| format!("glibc {major}.{minor}"),
    );
    RUN.replace(GLIBC, &needed)
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::process::Command;

    use super::*;

    #[test]
    fn the_newest_c_library_that_a_program_asks_for_is_found() {
        let program = b"\x7fELF\0GLIBC_2.2.5\0GLIBC_2.35\0GLIBC_2.4\0GLIBC_PRIVATE\0GLIBCXX_3.4.30\0GLIBC_";
        assert_eq!(newest_glibc(program), Some((2, 35)));
        assert_eq!(newest_glibc(b"no program"), None);
        // What libc's symbols say is true of what this test was built with.
        #[cfg(all(target_os = "linux", target_env = "gnu"))]
        assert!(newest_glibc(&fs::read(std::env::current_exe().unwrap()).unwrap()) >= Some((2, 17)));
    }

    /// `run.sh` among programs that tests/stub plays; beside it lies what the C library says, if anything.
    #[cfg(unix)]
    fn run_script(says: Option<&str>) -> (bool, String, String) {
        let folder = tempfile::tempdir().unwrap();
        let at = folder.path();
        for program in ["gs3", "xtask"] {
            let stub = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/stub/gs3");
            std::os::unix::fs::symlink(stub, at.join(program)).unwrap();
        }
        if let Some(says) = says {
            fs::write(at.join("glibc.txt"), says).unwrap();
        }
        fs::write(at.join("run.sh"), text(Some((2, 35)))).unwrap();
        let ended = Command::new("sh").arg(at.join("run.sh")).args(["--size", "a b"]).output().unwrap();
        let [out, err] = [ended.stdout, ended.stderr].map(|bytes| String::from_utf8(bytes).unwrap());
        (ended.status.success(), out, err)
    }

    #[cfg(unix)]
    #[test]
    fn the_script_passes_its_arguments_on_or_says_which_c_library_is_needed() {
        assert_eq!(run_script(None), (true, "measure --size a b\n".to_owned(), String::new()));
        let old = "./xtask: /lib/libc.so.6: version `GLIBC_2.35' not found (required by ./xtask)\n";
        let (succeeded, _, said) = run_script(Some(&format!("{old}{old}")));
        assert!(!succeeded);
        assert!(said.starts_with("run.sh: ./xtask needs glibc 2.35 or newer; this machine has "), "{said}");
        assert_eq!(said.lines().count(), 1, "{said}");
        let (succeeded, _, said) = run_script(Some("no memory"));
        assert_eq!((succeeded, said.as_str()), (false, "run.sh: ./xtask does not start: no memory\n"));
    }
}
