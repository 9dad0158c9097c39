//! Digest of what computes: this program, the libraries it has loaded, and the processor's features.
//!
//! A revision does not distinguish a modified tree from a clean one, so the program's file is hashed. The hash is
//! cached in the store by the file's path, size and times. The system's mathematics library differs between versions
//! and selects its code by processor when the program starts, so both are part of the digest.

use super::{Key, Store};
use crate::hash::{Digest, file_stamp::stamp, files::sha256, mapped::mapped, program};
use std::{fs::File, io, path::PathBuf, sync::OnceLock, time::SystemTime};

pub(super) fn digest(store: &Store) -> Option<Digest> {
    // Program and processor do not change while the process runs.
    static DIGEST: OnceLock<Option<Digest>> = OnceLock::new();
    *DIGEST.get_or_init(|| match own_file(store) {
        Ok(own) => {
            let mut all = Key::of("program").digest("file", own).text("machine", &machine());
            for library in LIBRARIES.get_or_init(libraries) {
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

/// The libraries mapped as code besides the program's own file, each with its size and time; on Linux only.
fn libraries() -> Vec<String> {
    let own = program::file().unwrap_or_default();
    let describe = |path: PathBuf| {
        let metadata = path.metadata().ok();
        let time = metadata.as_ref().and_then(|m| m.modified().ok()?.duration_since(SystemTime::UNIX_EPOCH).ok());
        format!("{}, {:?} bytes, {time:?}", path.display(), metadata.map(|m| m.len()))
    };
    mapped().into_iter().filter(|path| *path != own).map(describe).collect()
}

/// The libraries loaded before the first plugin.
static LIBRARIES: OnceLock<Vec<String>> = OnceLock::new();

/// Records the program's libraries before a plugin loads its own.
pub(crate) fn note_program() {
    LIBRARIES.get_or_init(libraries);
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
        assert!(libraries.iter().any(|library| library.contains("libc.so")), "{libraries:?}");
        assert!(libraries.iter().all(|library| library.contains("Some(")), "{libraries:?}");
    }
}
