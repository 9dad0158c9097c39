//! Digest of what computes: this program, the libraries it has loaded, and the processor's features.
//!
//! A revision does not distinguish a modified tree from a clean one, so the program's file is hashed. The hash is
//! cached in the store by the file's path, size and times. The system's mathematics library, by which plugins compute, and off GNU/Linux
//! the program, differs between versions and selects its code by processor, so both are part of the digest.

use super::{Key, Store};
use crate::hash::{Digest, file_stamp::stamp, files::sha256, mapped::mapped, program};
use std::{
    fs::File,
    io,
    path::{Path, PathBuf},
    sync::OnceLock,
};

pub(super) fn digest(store: &Store) -> Option<Digest> {
    // Program and processor do not change while the process runs.
    static DIGEST: OnceLock<Option<Digest>> = OnceLock::new();
    *DIGEST.get_or_init(|| match own_file(store) {
        Ok(own) => {
            let mut all = Key::of("program").digest("file", own).text("machine", &machine());
            for library in libraries() {
                all = all.text("library", library);
            }
            Some(all.done().digest())
        }
        Err(error) => {
            tracing::warn!("the program's own file cannot be read, so that nothing is kept: {error}");
            None
        }
    })
}

/// The digest of the program's file.
fn own_file(store: &Store) -> io::Result<Digest> {
    let (path, open) = (program::file()?, program::readable()?);
    let key = Key::of("file_hash").text("path", &path.to_string_lossy());
    let key = key.text("stamp", &stamp(&File::open(&open)?.metadata()?)).done();
    if let Some(kept) = store.get(&key).and_then(|entry| entry.bytes().try_into().ok()) {
        return Ok(Digest(kept));
    }
    let (_, digest) = sha256(&open)?;
    // If it cannot be stored, it is computed again next time.
    let _ = store.put(&key, &[&digest.0]);
    Ok(digest)
}

/// The libraries of the system that decide numbers, and those that are loaded before all others by the user's wish, each with its
/// SHA-256; on Linux only.
pub fn libraries() -> &'static [String] {
    static LIBRARIES: OnceLock<Vec<String>> = OnceLock::new();
    LIBRARIES.get_or_init(|| {
        let asked = std::env::var("LD_PRELOAD").unwrap_or_default() + "\n";
        let preloaded = asked + &std::fs::read_to_string("/etc/ld.so.preload").unwrap_or_default();
        let preloaded: Vec<_> = preloaded.split([':', ' ', '\n']).map(Path::new).filter_map(Path::file_name).collect();
        let decides =
            |name: &str| ["libm.so", "libm-", "libc.so", "libc-", "libgcc_s"].iter().any(|own| name.starts_with(own));
        let describe = |path: PathBuf| {
            let name = path.file_name().filter(|name| preloaded.contains(name) || decides(&name.to_string_lossy()))?;
            Some(format!("{} {}", name.to_string_lossy(), sha256(&path).ok()?.1))
        };
        mapped().into_iter().filter_map(describe).collect()
    })
}

/// Operating system, architecture, and [`cpu_features`].
fn machine() -> String {
    format!("{} {} {}", std::env::consts::OS, std::env::consts::ARCH, cpu_features().join(" "))
}

/// The processor features that libraries dispatch on, as far as this machine has them.
#[cfg(target_arch = "x86_64")]
pub fn cpu_features() -> Vec<&'static str> {
    let known = [
        ("sse3", is_x86_feature_detected!("sse3")),
        ("ssse3", is_x86_feature_detected!("ssse3")),
        ("sse4.1", is_x86_feature_detected!("sse4.1")),
        ("sse4.2", is_x86_feature_detected!("sse4.2")),
        ("avx", is_x86_feature_detected!("avx")),
        ("f16c", is_x86_feature_detected!("f16c")),
        ("avx2", is_x86_feature_detected!("avx2")),
        ("fma", is_x86_feature_detected!("fma")),
        ("avx512f", is_x86_feature_detected!("avx512f")),
        ("avx512dq", is_x86_feature_detected!("avx512dq")),
        ("avx512vl", is_x86_feature_detected!("avx512vl")),
    ];
    known.into_iter().filter_map(|(name, has)| has.then_some(name)).collect()
}

/// None are known of other processors.
#[cfg(not(target_arch = "x86_64"))]
pub fn cpu_features() -> Vec<&'static str> {
    Vec::new()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::Settings;

    #[test]
    fn a_program_is_identified_by_its_bytes_and_the_hash_is_cached() {
        let dir = tempfile::tempdir().unwrap();
        let store = Store::open(Settings::in_dir(dir.path()));
        let own = own_file(&store).unwrap();
        assert_eq!(own, sha256(&std::env::current_exe().unwrap()).unwrap().1);
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
        assert_eq!(own_file(&store).unwrap(), own);
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn the_mathematics_library_is_part_of_the_digest() {
        let libraries = libraries();
        assert!(libraries.iter().any(|library| library.starts_with("libc.so")), "{libraries:?}");
        assert!(libraries.iter().all(|library| library.split(' ').next_back().unwrap().len() == 64), "{libraries:?}");
    }
}
