//! Files that are whole or absent, also after a power cut, on a full disk, or when a process is killed: they are written beside
//! their names, synced and renamed, so a reader finds the old file or the new one. A link is replaced, never written through. What
//! a killed process leaves is removed by the next one that writes into the folder.

use std::{
    collections::BTreeSet,
    fs::{self, File, Metadata},
    io::{self, Write},
    path::{Path, PathBuf},
    sync::{
        Mutex, OnceLock, PoisonError,
        atomic::{AtomicU32, Ordering},
    },
    time::Duration,
};

/// Writes a file atomically and durably. A device, a pipe and what `/dev` names are written as they are.
///
/// # Errors
/// If the file cannot be written, for example because the disk is full; an earlier file of this name is then unchanged.
pub fn write(path: impl AsRef<Path>, bytes: impl AsRef<[u8]>) -> io::Result<()> {
    let path = path.as_ref();
    let is_stream = |about: Metadata| !about.is_file() && !about.is_dir();
    if path.starts_with("/dev") || path.starts_with("/proc") || fs::metadata(path).is_ok_and(is_stream) {
        return fs::write(path, bytes);
    }
    let mut part = Part::new(path)?;
    part.file().write_all(bytes.as_ref())?;
    part.replace()
}

/// A file that is being written beside its name; it is removed unless it gets its name.
#[derive(Debug)]
pub struct Part {
    file: File,
    part: PathBuf,
    path: PathBuf,
}

impl Part {
    /// Creates the side file of a file, and removes what killed processes have left in its folder.
    ///
    /// # Errors
    /// If it cannot be created.
    pub fn new(path: &Path) -> io::Result<Self> {
        static N_MADE: AtomicU32 = AtomicU32::new(0);
        remove_leftovers(folder_of(path), "");
        let mut name = path.file_name().unwrap_or_default().to_owned();
        name.push(format!(".{}{}", N_MADE.fetch_add(1, Ordering::Relaxed), suffix()));
        let part = path.with_file_name(name);
        Ok(Self { file: create(&part)?, part, path: path.into() })
    }

    /// The file to write into.
    pub fn file(&mut self) -> &mut File {
        &mut self.file
    }

    /// Gives the file its name, in place of an earlier one.
    ///
    /// # Errors
    /// If it cannot be synced or renamed.
    pub fn replace(self) -> io::Result<()> {
        self.file.sync_all()?;
        self.swap()?;
        sync_folder_of(&self.path)
    }

    /// As [`Self::replace`], for a file that may be lost in a power cut.
    ///
    /// # Errors
    /// If it cannot be renamed.
    pub fn swap(&self) -> io::Result<()> {
        fs::rename(&self.part, &self.path)
    }

    /// Gives the file its name, unless there is one.
    ///
    /// # Errors
    /// [`io::ErrorKind::AlreadyExists`] if there is; or if it cannot be synced or named.
    pub fn keep_new(self) -> io::Result<()> {
        self.file.sync_all()?;
        match fs::hard_link(&self.part, &self.path) {
            Ok(()) => sync_folder_of(&self.path),
            Err(_) if self.path.symlink_metadata().is_ok() => Err(io::ErrorKind::AlreadyExists.into()),
            // Some file systems have no links.
            Err(_) => self.replace(),
        }
    }
}

impl Drop for Part {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.part);
    }
}

/// Creates a new file; a file or link of this name is removed first.
///
/// # Errors
/// If it cannot be created.
pub fn create(path: &Path) -> io::Result<File> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
        _ => {}
    }
    File::options().write(true).create_new(true).open(path)
}

/// Writes the folder that holds a file to the disk, so that the file's name outlasts a power cut.
///
/// # Errors
/// If the system reports one. Systems that cannot sync a folder are passed over.
pub fn sync_folder_of(path: &Path) -> io::Result<()> {
    if cfg!(not(unix)) {
        return Ok(());
    }
    match File::open(folder_of(path)).and_then(|folder| folder.sync_all()) {
        Err(error) if matches!(error.kind(), io::ErrorKind::InvalidInput | io::ErrorKind::Unsupported) => Ok(()),
        synced => synced,
    }
}

fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| *folder != Path::new("")).unwrap_or(Path::new("."))
}

/// Ending of the name of a file or folder that is removed as soon as this process is no more: this system and process.
pub fn suffix() -> String {
    format!(".{}.{}.part", system(), std::process::id())
}

/// Age from which what another system has left is removed: it is longer than anything is written.
const OLD: Duration = Duration::from_secs(86_400);

/// Removes, once for each folder, what killed processes have left in it under names of this begin and with the [`suffix`]; what other
/// systems have left, on a shared disk or before this one was started, a day later.
pub fn remove_leftovers(folder: &Path, prefix: &str) {
    static SEEN: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());
    let Ok(full) = fs::canonicalize(folder) else { return };
    if !SEEN.lock().unwrap_or_else(PoisonError::into_inner).insert(full) {
        return;
    }
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let (name, path) = (entry.file_name(), entry.path());
        let name = name.to_str().filter(|name| name.starts_with(prefix)).unwrap_or_default();
        let (Some(is_sure), Ok(about)) = (is_left(name), entry.metadata()) else { continue };
        let age = about.modified().ok().and_then(|time| time.elapsed().ok()).unwrap_or_default();
        if is_sure || age > OLD {
            // An error is that of another process, which removes it, too, or of another user.
            let _ = if about.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) };
        }
    }
}

/// Whether a name of this form is that of a process that is no more, `false` where this system cannot know; `None` of one that lives.
fn is_left(name: &str) -> Option<bool> {
    let (rest, process) = name.strip_suffix(".part")?.rsplit_once('.')?;
    let (process, (_, of)) = (process.parse::<u32>().ok()?, rest.rsplit_once('.')?);
    if of != system() {
        return (of.len() == 16 && of.bytes().all(|byte| byte.is_ascii_hexdigit())).then_some(false);
    }
    let is_alive = |process: u32| Path::new("/proc").join(process.to_string()).exists();
    (process != std::process::id() && !is_alive(process)).then(|| is_alive(1))
}

/// This start of this machine, or container: process ids mean the same within it.
fn system() -> &'static str {
    static SYSTEM: OnceLock<String> = OnceLock::new();
    SYSTEM.get_or_init(|| {
        let boot = fs::read("/proc/sys/kernel/random/boot_id").unwrap_or_default();
        let space = fs::read_link("/proc/self/ns/pid").unwrap_or_default();
        // FNV-1a.
        let add = |hash: u64, byte: &u8| (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3);
        let hash = boot.iter().chain(space.as_os_str().as_encoded_bytes()).fold(0xcbf2_9ce4_8422_2325, add);
        format!("{hash:016x}")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_replaced_whole_and_no_side_file_stays() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("results.json");
        for text in ["a longer text", "short"] {
            write(&path, text.as_bytes()).unwrap();
            assert_eq!(fs::read_to_string(&path).unwrap(), text);
        }
        assert!(write(dir.path().join("none/results.json"), b"x").is_err());
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
    }

    #[cfg(unix)]
    #[test]
    fn links_are_replaced_and_not_written_through() {
        let dir = tempfile::tempdir().unwrap();
        let (path, elsewhere) = (dir.path().join("results.json"), dir.path().join("elsewhere"));
        fs::write(&elsewhere, "mine").unwrap();
        std::os::unix::fs::symlink(&elsewhere, &path).unwrap();
        write(&path, b"new").unwrap();
        assert_eq!(fs::read_to_string(&elsewhere).unwrap(), "mine");
        assert_eq!(fs::read_to_string(&path).unwrap(), "new");
        assert!(!path.is_symlink());
        std::os::unix::fs::symlink(&elsewhere, dir.path().join("new")).unwrap();
        let error = Part::new(&dir.path().join("new")).unwrap().keep_new().unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::AlreadyExists);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn what_dead_processes_left_is_removed_and_what_others_write_stays() {
        let mut dead = std::process::Command::new("true").spawn().unwrap();
        dead.wait().unwrap();
        let dir = tempfile::tempdir().unwrap();
        let at = |name: String| dir.path().join(name);
        let of = |system: &str, process: u32| format!("out.zip.0.{system}.{process}.part");
        let (left, alive) = (at(of(system(), dead.id())), at(of(system(), 1)));
        let (other, mine) = (at(of("0123456789abcdef", 1)), at("mine.part".into()));
        let old = at(of("0123456789abcdef", 2));
        [&left, &alive, &other, &mine, &old].iter().for_each(|file| fs::write(file, "half").unwrap());
        let days_ago = std::time::SystemTime::now() - 3 * OLD;
        File::options().write(true).open(&old).unwrap().set_modified(days_ago).unwrap();
        fs::create_dir_all(
            at(format!("unpacked{}", suffix().replace(&std::process::id().to_string(), &dead.id().to_string())))
                .join("a"),
        )
        .unwrap();
        write(at("new".into()), b"whole").unwrap();
        let mut names: Vec<_> = fs::read_dir(dir.path()).unwrap().map(|entry| entry.unwrap().path()).collect();
        names.sort();
        let mut expected = vec![alive, other, mine, at("new".into())];
        expected.sort();
        assert_eq!(names, expected);
    }

    #[test]
    fn a_file_that_is_not_finished_has_no_name() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("out.zip");
        let mut part = Part::new(&path).unwrap();
        part.file().write_all(b"half").unwrap();
        assert!(!path.exists());
        drop(part);
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0);
        let mut part = Part::new(&path).unwrap();
        part.file().write_all(b"whole").unwrap();
        part.keep_new().unwrap();
        assert_eq!((fs::read(&path).unwrap(), fs::read_dir(dir.path()).unwrap().count()), (b"whole".to_vec(), 1));
        assert!(Part::new(&path).unwrap().keep_new().is_err());
    }
}
