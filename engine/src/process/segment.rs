//! Memory shared with another process.
#![allow(unsafe_code, reason = "maps memory")]

use super::wire::{NewSegment, Place};
use crate::recording::codec::{self, RecordedItem};
use osteoflow_node::{Buffer, Item, PayloadType, PortPayload, Value};
use rustix::{
    fd::{AsFd, BorrowedFd, OwnedFd},
    fs, io,
    mm::{MapFlags, ProtFlags, mmap, munmap},
};
use std::{
    collections::BTreeMap,
    ops::Range,
    ptr::{self, NonNull},
    sync::{
        Arc,
        atomic::{AtomicU8, Ordering},
    },
};

/// Segments are at least so large, and grow by doubling.
const MIN_BYTES: usize = 64 << 10;

/// Mapped memory.
struct Map {
    at: NonNull<u8>,
    n_bytes: usize,
}

// SAFETY: plain memory; a `Map` that is written has one owner.
unsafe impl Send for Map {}
// SAFETY: as above.
unsafe impl Sync for Map {}

impl Map {
    fn of(fd: BorrowedFd<'_>, n_bytes: usize, access: ProtFlags) -> io::Result<Self> {
        // A shorter file would end the process at its first access.
        if fs::fstat(fd)?.st_size < i64::try_from(n_bytes).map_err(|_| io::Errno::OVERFLOW)? {
            return Err(io::Errno::INVAL);
        }
        // SAFETY: a fresh mapping at an address that the system chooses.
        let at = unsafe { mmap(ptr::null_mut(), n_bytes, access, MapFlags::SHARED, fd, 0) }?;
        Ok(Self { at: NonNull::new(at.cast()).ok_or(io::Errno::NOMEM)?, n_bytes })
    }

    fn bytes(&self) -> &[u8] {
        // SAFETY: mapped for as long as `self`; its maker does not write while the other side uses it.
        unsafe { std::slice::from_raw_parts(self.at.as_ptr(), self.n_bytes) }
    }
}

impl Drop for Map {
    fn drop(&mut self) {
        // SAFETY: mapped by `of`, and unmapped once. It fails only for ranges that are not mapped.
        let _ = unsafe { munmap(self.at.as_ptr().cast(), self.n_bytes) };
    }
}

/// A page whose first byte says that the user asked to stop.
pub(crate) struct StopPage {
    map: Map,
    fd: Option<OwnedFd>,
}

const PAGE_BYTES: usize = 4096;

impl StopPage {
    pub(crate) fn new() -> io::Result<Self> {
        let fd = memory()?;
        fs::ftruncate(&fd, PAGE_BYTES as u64)?;
        Ok(Self { map: Map::of(fd.as_fd(), PAGE_BYTES, ProtFlags::READ | ProtFlags::WRITE)?, fd: Some(fd) })
    }

    /// The other side's.
    pub(crate) fn of(fd: &OwnedFd) -> io::Result<Self> {
        Ok(Self { map: Map::of(fd.as_fd(), PAGE_BYTES, ProtFlags::READ)?, fd: None })
    }

    pub(crate) fn fd(&self) -> Option<BorrowedFd<'_>> {
        self.fd.as_ref().map(AsFd::as_fd)
    }

    fn byte(&self) -> &AtomicU8 {
        // SAFETY: the first byte of a mapped page, which both sides use atomically only.
        unsafe { AtomicU8::from_ptr(self.map.at.as_ptr()) }
    }

    /// Asks the other side to stop; only for the side that made it.
    pub(crate) fn stop(&self) {
        if self.fd.is_some() {
            self.byte().store(1, Ordering::Relaxed);
        }
    }

    pub(crate) fn is_stopped(&self) -> bool {
        self.byte().load(Ordering::Relaxed) != 0
    }
}

/// The segments that this process writes.
#[derive(Default)]
pub(crate) struct Pool {
    segments: Vec<Segment>,
}

struct Segment {
    fd: OwnedFd,
    map: Map,
    is_told: bool,
    used: Used,
}

#[derive(Clone, Copy, PartialEq)]
enum Used {
    Free,
    /// By the message that is being written, or the firing that it asks for.
    Now,
    /// Until it is released: a constant.
    Kept,
    /// By the other side, which says so.
    There,
}

impl Pool {
    /// Writes an item into a segment that nobody uses.
    pub(crate) fn put(&mut self, item: &Item, is_kept: bool) -> io::Result<Place> {
        let parts = codec::parts_on(PortPayload::Any, item);
        let n_bytes = parts.len();
        let fits = |segment: &Segment| segment.used == Used::Free && segment.map.n_bytes >= n_bytes;
        let smallest = |at: &usize| self.segments[*at].map.n_bytes;
        let index = match (0..self.segments.len()).filter(|at| fits(&self.segments[*at])).min_by_key(smallest) {
            Some(index) => index,
            None => {
                self.segments.push(Segment::new(n_bytes)?);
                self.segments.len() - 1
            }
        };
        let segment = &mut self.segments[index];
        segment.used = if is_kept { Used::Kept } else { Used::Now };
        let mut at = 0;
        for slice in parts.slices() {
            // SAFETY: the map is at least as long as all parts, this process alone writes it, and nobody reads it now.
            unsafe { ptr::copy_nonoverlapping(slice.as_ptr(), segment.map.at.as_ptr().add(at), slice.len()) };
            at += slice.len();
        }
        Ok(Place { segment: index as u32, n_bytes: n_bytes as u64 })
    }

    /// Whether this item lies at the place.
    pub(crate) fn holds(&self, place: Place, item: &Item) -> bool {
        let parts = codec::parts_on(PortPayload::Any, item);
        let Some(segment) = self.segments.get(place.segment as usize).filter(|_| parts.len() as u64 == place.n_bytes)
        else {
            return false;
        };
        let mut rest = segment.map.bytes();
        parts.slices().all(|slice| match rest.split_at_checked(slice.len()) {
            Some((here, after)) => {
                rest = after;
                here == slice
            }
            None => false,
        })
    }

    /// Segments that the other side has not heard of, with their descriptors.
    pub(crate) fn news(&mut self) -> (Vec<NewSegment>, Vec<BorrowedFd<'_>>) {
        let mut fds = Vec::new();
        let mut new = Vec::new();
        for (id, segment) in self.segments.iter_mut().enumerate().filter(|(_, segment)| !segment.is_told) {
            segment.is_told = true;
            new.push(NewSegment { id: id as u32, n_bytes: segment.map.n_bytes as u64 });
            fds.push(segment.fd.as_fd());
        }
        (new, fds)
    }

    /// A constant is no longer used.
    pub(crate) fn release(&mut self, place: Place) {
        if let Some(segment) = self.segments.get_mut(place.segment as usize) {
            segment.used = Used::There;
        }
    }

    /// The other side has answered, and uses these segments yet.
    pub(crate) fn answered(&mut self, held: &[u32]) {
        for (id, segment) in self.segments.iter_mut().enumerate().filter(|(_, segment)| segment.used != Used::Kept) {
            segment.used = if held.contains(&(id as u32)) { Used::There } else { Used::Free };
        }
    }
}

impl Segment {
    fn new(n_bytes: usize) -> io::Result<Self> {
        let n_bytes = n_bytes.next_power_of_two().max(MIN_BYTES);
        let fd = memory()?;
        fs::ftruncate(&fd, n_bytes as u64)?;
        let map = Map::of(fd.as_fd(), n_bytes, ProtFlags::READ | ProtFlags::WRITE)?;
        Ok(Self { fd, map, is_told: false, used: Used::Free })
    }
}

/// A file without a name, in memory.
#[cfg(target_os = "linux")]
fn memory() -> io::Result<OwnedFd> {
    fs::memfd_create("osteoflow", fs::MemfdFlags::CLOEXEC)
}

#[cfg(not(target_os = "linux"))]
fn memory() -> io::Result<OwnedFd> {
    use rustix::shm;
    use std::sync::atomic::{AtomicU32, Ordering};
    static N_MADE: AtomicU32 = AtomicU32::new(0);
    let name = format!("/osteoflow-{}-{}", std::process::id(), N_MADE.fetch_add(1, Ordering::Relaxed));
    let flags = shm::OFlags::CREATE | shm::OFlags::EXCL | shm::OFlags::RDWR;
    let fd = shm::open(&name, flags, fs::Mode::RUSR | fs::Mode::WUSR)?;
    shm::unlink(&name)?;
    Ok(fd)
}

/// The segments of the other process, mapped for reading.
#[derive(Default)]
pub(crate) struct Views {
    maps: BTreeMap<u32, Arc<Map>>,
}

/// A column within a segment.
struct Rows {
    map: Arc<Map>,
    range: Range<usize>,
}

impl AsRef<[u8]> for Rows {
    fn as_ref(&self) -> &[u8] {
        &self.map.bytes()[self.range.clone()]
    }
}

impl Views {
    /// Maps segments that are new.
    pub(crate) fn add(&mut self, new: &[NewSegment], fds: Vec<OwnedFd>) -> io::Result<()> {
        if new.len() != fds.len() {
            return Err(io::Errno::INVAL);
        }
        for (segment, fd) in new.iter().zip(fds) {
            let n_bytes = usize::try_from(segment.n_bytes).map_err(|_| io::Errno::OVERFLOW)?;
            self.maps.insert(segment.id, Arc::new(Map::of(fd.as_fd(), n_bytes, ProtFlags::READ)?));
        }
        Ok(())
    }

    /// The item at a place, or why it cannot be read; its columns stay where they are.
    pub(crate) fn item(&self, place: Place) -> Result<RecordedItem, String> {
        let Place { segment, n_bytes } = place;
        let map = self.maps.get(&segment).ok_or_else(|| format!("shared memory {segment} was never sent"))?;
        let bytes = usize::try_from(n_bytes).ok().and_then(|n| map.bytes().get(..n));
        let short = || format!("shared memory {segment} has {} bytes, {n_bytes} were named", map.n_bytes);
        let bytes = bytes.ok_or_else(short)?;
        let borrow = |range| -> Buffer { Arc::new(Rows { map: map.clone(), range }) };
        codec::decode_borrowed(bytes, Some(&borrow)).map_err(|error| error.to_string())
    }

    /// The value at a place, for an output of this payload.
    pub(crate) fn value(
        &self,
        place: Place,
        payload: PortPayload,
        types: &[&'static PayloadType],
    ) -> Result<Value, String> {
        let item = self.item(place)?;
        let (name, version) = item.payload.unwrap_or_default();
        let ty = match payload {
            PortPayload::Type(ty) => Some(ty),
            PortPayload::Any => types.iter().copied().find(|ty| ty.name == name),
        };
        let ty = ty.filter(|ty| (ty.name, ty.version) == (&*name, version));
        let ty = ty.ok_or_else(|| format!("{name}@{version}: the port gives {}", payload.name()))?;
        let view = item.body.map_err(|_| format!("{}: there is no value", ty.name))?;
        ty.from_view(&view).map_err(|error| format!("{}: {error}", ty.name))
    }

    /// The segments of which something is still used.
    pub(crate) fn held(&self) -> Vec<u32> {
        self.maps.iter().filter(|(_, map)| Arc::strong_count(map) > 1).map(|(id, _)| *id).collect()
    }
}
