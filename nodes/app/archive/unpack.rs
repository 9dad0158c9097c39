//! Opens an archive, which may be a stranger's.

use super::{
    GRAPH, INDEX, RESULTS,
    index::{Entry, FORMAT, Index, Role, What},
    search::{Search, has_content},
};
use crate::app::{error::UsageError, plugins::Plugins, sweep::folder_error};
use anyhow::{Context, Result, anyhow, bail};
use clap::Args;
use osteoflow_engine::{
    durable,
    hash::copy_hashed,
    regular,
    sweep::{Folder, Spec},
};
use std::{
    collections::{BTreeMap, BTreeSet},
    fs::{self, File},
    io::{self, Read},
    path::{Component, Path, PathBuf},
};
use zip::ZipArchive;

/// Most bytes of the list of files.
const MAX_INDEX: u64 = 256 << 20;
/// Bytes that any archive may unpack to.
const FREE: u64 = 1 << 30;
/// Bytes for each of the archive's own that it may unpack to beyond: tables of numbers shrink to a tenth.
const RATIO: u64 = 100;

/// Begin of the name of a folder that is being unpacked into.
const UNPACKING: &str = ".osteoflow-unpacking-";

/// How an archive is run again.
#[derive(Debug, Clone, Default, Args)]
pub struct ArchiveArgs {
    /// For an archive of `osteoflow export`: load the plugins in it. They run with your rights, so look at them first.
    #[arg(long)]
    pub allow_plugins: bool,

    /// For an archive without its inputs: a folder in which they are found by their contents; may be given again.
    #[arg(long, value_name = "DIR")]
    pub data: Vec<PathBuf>,

    /// The folder to unpack an archive into, which is kept. Default: its name without .zip, in the current folder.
    #[arg(long, value_name = "DIR")]
    pub unpack: Option<PathBuf>,
}

/// Whether `path` is an archive, or the folder of an unpacked one.
pub(crate) fn is_archive(path: &Path) -> bool {
    if path.is_dir() {
        return path.join(INDEX).is_file();
    }
    let mut begin = [0; 4];
    regular(path).and_then(fs::File::open).and_then(|mut file| file.read_exact(&mut begin)).is_ok()
        && begin == *b"PK\x03\x04"
}

impl ArchiveArgs {
    /// The graph in the archive that `graph` names, unpacked, and the specification of its sweep; `plugins` are restricted to
    /// those that the user allows. `None` if `graph` is no archive.
    ///
    /// # Errors
    /// The archive is not sound, brings plugins that are not allowed, or lacks inputs that are not found.
    pub(crate) fn open(&self, graph: &Path, plugins: &mut Plugins) -> Result<Option<(PathBuf, Option<Spec>)>> {
        if !is_archive(graph) {
            let given = [
                ("--allow-plugins", self.allow_plugins),
                ("--data", !self.data.is_empty()),
                ("--unpack", self.unpack.is_some()),
            ];
            return match given.iter().find(|(_, is_given)| *is_given) {
                Some((option, _)) if graph.exists() => Err(UsageError(format!(
                    "{option} is for an archive of `osteoflow export`, and {} is none",
                    graph.display()
                ))
                .into()),
                _ => Ok(None),
            };
        }
        let (index, dir) = if graph.is_dir() {
            (read_index(&graph.join(INDEX), regular(graph.join(INDEX)).and_then(fs::File::open)?)?, graph.to_owned())
        } else {
            let mut archive = Archive::open(graph)?;
            self.check_plugins(&archive.index, graph, plugins)?;
            let dir = self.unpack.clone().unwrap_or_else(|| graph.file_stem().unwrap_or_default().into());
            archive.unpack(&dir)?;
            (archive.index, dir)
        };
        self.check_plugins(&index, graph, plugins)?;
        plugins.only = Some(match self.allow_plugins {
            true => index.of(Role::Plugin).map(|entry| entry.sha256.clone()).collect(),
            false => BTreeSet::new(),
        });
        self.find_inputs(&index, &dir)?;
        let spec = match index.what {
            What::Run => None,
            What::Sweep => {
                Some(Folder::open(&dir.join(RESULTS)).and_then(|folder| folder.spec()).map_err(folder_error)?)
            }
        };
        Ok(Some((dir.join(GRAPH), spec)))
    }

    /// Refuses plugins of the archive unless the user allows them, or names others in their place.
    fn check_plugins(&self, index: &Index, archive: &Path, plugins: &Plugins) -> Result<()> {
        if self.allow_plugins || plugins.none {
            return Ok(());
        }
        let name = |path: &Path| path.file_name().map(ToOwned::to_owned);
        let is_replaced = |entry: &&Entry| plugins.files.iter().any(|file| name(file) == name(Path::new(&entry.path)));
        let brought: Vec<_> =
            index.of(Role::Plugin).filter(|entry| !is_replaced(entry)).map(|entry| entry.path.as_str()).collect();
        if brought.is_empty() {
            return Ok(());
        }
        usage!(
            "{} brings plugins ({}), which would run with your rights; look at them, then allow them by --allow-plugins, or name your \
             own of the same file name by --plugin FILE",
            archive.display(),
            brought.join(", ")
        );
    }

    /// Takes inputs that were left out from the user's folders.
    fn find_inputs(&self, index: &Index, dir: &Path) -> Result<()> {
        let lacks =
            |entry: &&Entry| !entry.included && !has_content(&dir.join(&entry.path), entry.bytes, &entry.sha256);
        let lacking: Vec<_> = index.files.iter().filter(lacks).collect();
        if lacking.is_empty() {
            return Ok(());
        }
        let search = Search::below(&self.data)?;
        let mut missing = Vec::new();
        for entry in lacking {
            let to = dir.join(&entry.path);
            match search.find(entry.bytes, &entry.sha256) {
                Some(found) => {
                    let cannot = || format!("{} cannot be copied to {}", found.display(), to.display());
                    fs::create_dir_all(to.parent().unwrap_or(dir)).with_context(cannot)?;
                    fs::copy(&found, &to).with_context(cannot)?;
                }
                None => missing.push(format!("{} ({} bytes, SHA-256 {})", entry.path, entry.bytes, entry.sha256)),
            }
        }
        match missing.is_empty() {
            true => Ok(()),
            false => {
                let folders =
                    if self.data.is_empty() { "" } else { ", and no file of the --data folders has their contents" };
                usage!(
                    "{} inputs were left out of the archive{folders}: {}; name a folder that holds them by --data DIR",
                    missing.len(),
                    missing.join(", ")
                );
            }
        }
    }
}

/// The folder of results of an archive, unpacked into `dir`; `path` itself if it is no archive.
///
/// # Errors
/// The archive is not sound.
pub(crate) fn results(path: &Path, dir: &Path) -> Result<PathBuf> {
    if !is_archive(path) {
        return Ok(path.into());
    }
    if path.is_dir() {
        return Ok(path.join(RESULTS));
    }
    let mut archive = Archive::open(path)?;
    archive.extract(dir, |entry| entry.role == Role::Result)?;
    Ok(dir.join(RESULTS))
}

/// What an archive holds; `None` for any other file, also another zip.
///
/// # Errors
/// The archive is not sound.
pub(crate) fn index_of(path: &Path) -> Result<Option<Index>> {
    let is_ours = |file: File| ZipArchive::new(file).is_ok_and(|zip| zip.index_for_name(INDEX).is_some());
    let is_archive = !path.is_dir() && is_archive(path) && regular(path).and_then(fs::File::open).is_ok_and(is_ours);
    is_archive.then(|| Ok(Archive::open(path)?.index)).transpose()
}

/// A zip whose list of files is sound.
struct Archive {
    path: PathBuf,
    zip: ZipArchive<File>,
    index: Index,
}

impl Archive {
    fn open(path: &Path) -> Result<Self> {
        let shown = path.display();
        let file = regular(path).and_then(fs::File::open).with_context(|| format!("{shown} cannot be read"))?;
        let n_bytes = file.metadata()?.len();
        let mut zip = ZipArchive::new(file).with_context(|| format!("{shown} is no sound zip"))?;
        if zip.has_duplicate_names() || zip.has_overlapping_files()? {
            bail!("{shown} is refused: files in it have one name, or share their bytes");
        }
        let index = match zip.by_name(INDEX) {
            Ok(entry) => read_index(path, entry)?,
            Err(_) => {
                usage!("{shown} is a zip, but none of `osteoflow export`: it has no {INDEX}");
            }
        };
        let unpacked = index
            .files
            .iter()
            .filter(|entry| entry.included)
            .try_fold(0_u64, |sum, entry| sum.checked_add(entry.bytes));
        let most = FREE.saturating_add(n_bytes.saturating_mul(RATIO));
        if unpacked.is_none_or(|unpacked| unpacked > most) {
            bail!(
                "{shown} is refused: its {n_bytes} bytes would unpack to {}, and at most {most} are taken",
                unpacked.unwrap_or(u64::MAX)
            );
        }
        let included = index.files.iter().filter(|listed| listed.included);
        let listed: BTreeMap<&str, &Entry> = included.map(|listed| (&*listed.path, listed)).collect();
        for at in 0..zip.len() {
            let entry = zip.by_index_raw(at)?;
            let name = entry.name()?.into_owned();
            if name == INDEX {
                continue;
            }
            let listed = listed.get(&*name);
            let why = match listed {
                None => "it is not listed",
                Some(_) if !entry.is_file() || entry.is_symlink() => "it is a link or a folder",
                Some(_) if entry.encrypted() => "it is encrypted",
                Some(listed) if entry.size() != listed.bytes => "its size is not the listed one",
                Some(_) => continue,
            };
            bail!("{shown} is refused: {name:?}: {why}");
        }
        Ok(Self { path: path.into(), zip, index })
    }

    /// Unpacks everything into `dir`; one that holds this archive already is taken as it is.
    fn unpack(&mut self, dir: &Path) -> Result<()> {
        if dir.exists() && fs::read_dir(dir).is_ok_and(|mut entries| entries.next().is_some()) {
            let is_ours =
                |entry: &Entry| !entry.included || has_content(&dir.join(&entry.path), entry.bytes, &entry.sha256);
            let mut list = Vec::new();
            self.zip.by_name(INDEX)?.read_to_end(&mut list)?;
            if regular(dir.join(INDEX)).and_then(fs::read).is_ok_and(|there| there == list)
                && self.index.files.iter().all(is_ours)
            {
                return Ok(());
            }
            usage!(
                "{} holds something else than {}; name another folder by --unpack DIR",
                dir.display(),
                self.path.display()
            );
        }
        let cannot = || format!("{} cannot be made a folder", dir.display());
        let parent = dir.parent().filter(|parent| *parent != Path::new("")).unwrap_or(Path::new("."));
        fs::create_dir_all(parent).with_context(cannot)?;
        durable::remove_leftovers(parent, UNPACKING);
        let mut part = tempfile::Builder::new();
        let part = part.prefix(UNPACKING).suffix(&durable::suffix()).tempdir_in(parent).with_context(cannot)?;
        self.extract(part.path(), |_| true)?;
        let mut list = File::create_new(part.path().join(INDEX)).with_context(cannot)?;
        io::copy(&mut self.zip.by_name(INDEX)?, &mut list).with_context(cannot)?;
        fs::rename(part.keep(), dir).with_context(cannot)
    }

    /// Writes files into an empty folder, each with its listed content.
    fn extract(&mut self, dir: &Path, which: impl Fn(&Entry) -> bool) -> Result<()> {
        for entry in self.index.files.iter().filter(|entry| entry.included && which(entry)) {
            let to = dir.join(&entry.path);
            let refused = |why: &str| anyhow!("{} is refused: {:?} {why}", self.path.display(), entry.path);
            let packed = self.zip.by_name(&entry.path).map_err(|_| refused("is listed, and missing"))?;
            let cannot = || format!("{} cannot be written", to.display());
            fs::create_dir_all(to.parent().unwrap_or(dir)).with_context(cannot)?;
            let mut file = File::create_new(&to).with_context(cannot)?;
            let (bytes, digest) = copy_hashed(packed.take(entry.bytes + 1), &mut file)
                .map_err(|error| refused(&format!("cannot be unpacked: {error}")))?;
            if (bytes, digest.to_string()) != (entry.bytes, entry.sha256.clone()) {
                let _ = fs::remove_file(&to);
                return Err(refused("is not what is listed: its SHA-256 is another"));
            }
        }
        Ok(())
    }
}

/// Reads and checks the list of files.
fn read_index(archive: &Path, from: impl Read) -> Result<Index> {
    let shown = archive.display();
    let mut text = Vec::new();
    from.take(MAX_INDEX + 1).read_to_end(&mut text).with_context(|| format!("{shown} cannot be read"))?;
    if text.len() as u64 > MAX_INDEX {
        bail!("{shown} is refused: its {INDEX} has more than {MAX_INDEX} bytes");
    }
    let index: Index = serde_json::from_slice(&text).with_context(|| format!("{shown}: {INDEX} cannot be read"))?;
    if index.format != FORMAT {
        bail!(
            "{shown} has format {}, this program reads {FORMAT}; open it with osteoflow {}",
            index.format,
            index.version
        );
    }
    for entry in &index.files {
        let path = Path::new(&entry.path);
        let is_below = !entry.path.is_empty() && path.components().all(|part| matches!(part, Component::Normal(_)));
        if !is_below || entry.path.contains(['\\', '\0', ':']) || entry.path == INDEX {
            bail!("{shown} is refused: {:?} leads out of the archive, or is no name of a file", entry.path);
        }
    }
    Ok(index)
}
