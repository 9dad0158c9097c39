//! The plugin ABI: the Rust side of `include/osteoflow.h`, which documents each struct and field.
//!
//! No Rust layout crosses the boundary: no `Vec`, no trait object, no `TypeId`. So a plugin may be built by another
//! compiler, in another profile, in another language. A test compares sizes and offsets of these structs, the header and
//! the golden file `include/layout.txt`.

mod head;
mod raw;
pub mod schema;
mod view;

pub use head::{head_offsets, head_size};
pub use raw::{Plain, entries, list, required_text, text};
pub use view::{IncomingView, OutgoingView, Ownership};

use std::{ffi::c_void, fmt, ptr};

/// Raised by incompatible changes; a plugin with another major version is refused.
pub const MAJOR: u32 = 1;
/// Raised by additions.
pub const MINOR: u32 = 0;
/// The first bytes of a description.
pub const MAGIC: [u8; 8] = *b"OSTEOPLG";
/// The name of the exported function.
pub const SYMBOL: &str = "osteoflow_describe";

/// Return codes of the functions of a kind.
pub mod status {
    /// Success.
    pub const OK: i32 = 0;
    /// The source has ended.
    pub const END: i32 = 1;
    /// Failure; the reason was given to `fail`.
    pub const FAILED: i32 = 2;
    /// A panic or exception was caught.
    pub const PANICKED: i32 = 3;
}

/// How panics of a plugin end.
pub mod panics {
    /// There are none.
    pub const NONE: u32 = 0;
    /// They are caught.
    pub const UNWIND: u32 = 1;
    /// They abort the program.
    pub const ABORT: u32 = 2;
}

/// The codes of [`Slot::what`] and [`Slot::flags`].
pub mod slot {
    /// One item.
    pub const ITEM: u32 = 0;
    /// The items of a collecting port.
    pub const ITEMS: u32 = 1;
    /// No item, with the reason.
    pub const ABSENT: u32 = 2;
    /// Flag: the same value at every firing.
    pub const CONSTANT: u32 = 1;
}

/// The codes of [`SchemaEntry::shape`] and [`SchemaEntry::flags`].
pub mod entry {
    /// `uint8_t`
    pub const BOOL: u32 = 1;
    /// `int64_t`
    pub const INT: u32 = 2;
    /// `double`
    pub const FLOAT: u32 = 3;
    /// `double[n]`
    pub const FLOATS: u32 = 4;
    /// `osteoflow_numbers`
    pub const FLOAT_LIST: u32 = 5;
    /// `osteoflow_text`
    pub const TEXT: u32 = 6;
    /// A column.
    pub const COLUMN: u32 = 7;
    /// Flag: a view may lack the entry.
    pub const OPTIONAL: u32 = 1;
}

/// The codes of [`Param::what`].
pub mod param {
    /// There is no such parameter.
    pub const MISSING: u32 = 0;
    /// A boolean.
    pub const BOOL: u32 = 1;
    /// A number.
    pub const NUMBER: u32 = 2;
    /// A text.
    pub const TEXT: u32 = 3;
    /// A list of numbers.
    pub const NUMBERS: u32 = 4;
    /// Anything else.
    pub const OTHER: u32 = 5;
}

/// The codes and flags of kinds and ports.
pub mod kind {
    /// [`super::Kind::role`]: fires when its inputs join.
    pub const NODE: u32 = 0;
    /// [`super::Kind::role`]: produces items by itself.
    pub const SOURCE: u32 = 1;
    /// [`super::Kind::role`]: follows the wall clock.
    pub const LIVE_SOURCE: u32 = 2;
    /// Flag of [`super::Kind`]: one item on each output.
    pub const CONSTANT: u32 = 1;
    /// Flag of [`super::Kind`]: its answers may differ though everything that it is given is the same.
    pub const UNSTEADY: u32 = 2;
    /// Flag of [`super::Input`]: may stay unwired.
    pub const OPTIONAL: u32 = 1;
    /// Flag of [`super::Input`]: ignored by the kind.
    pub const UNUSED: u32 = 2;
    /// [`super::Input::join`]
    pub const EACH: u32 = 0;
    /// [`super::Input::join`]
    pub const STAMP: u32 = 1;
    /// [`super::Input::join`]
    pub const COLLECT: u32 = 2;
    /// [`super::Input::join`]
    pub const LATEST: u32 = 3;
    /// [`super::Input::join`]
    pub const INTERPOLATE: u32 = 4;
    /// [`super::Input::join`]
    pub const ONCE: u32 = 5;
    /// [`super::Input::join`]
    pub const PREVIOUS: u32 = 6;
}

/// Declares the structs, and [`layout`] over all of them.
macro_rules! structs {
    ($($(#[$about:meta])* $name:ident = $c:literal { $($(#[$doc:meta])* $field:ident: $ty:ty,)* })*) => {
        $(
            $(#[$about])*
            #[doc = concat!("`", $c, "` of the header.")]
            #[repr(C)]
            #[derive(Debug, Clone, Copy)]
            #[allow(missing_docs, reason = "the header says what each field means")]
            pub struct $name { $($(#[$doc])* pub $field: $ty,)* }
        )*

        /// The size of every struct and the offset of every field, as the golden file has them.
        pub fn layout() -> String {
            let mut rows = String::new();
            $(
                rows += &format!("{} {}\n", $c, size_of::<$name>());
                $(rows += &format!("{}.{} {}\n", $c, stringify!($field), std::mem::offset_of!($name, $field));)*
            )*
            rows
        }
    };
}

structs! {
    Text = "osteoflow_text" { data: *const u8, length: u64, }
    Numbers = "osteoflow_numbers" { data: *const f64, length: u64, }
    Owner = "osteoflow_owner" {
        self_: *mut c_void,
        hold: Option<unsafe extern "C" fn(*mut c_void) -> *mut c_void>,
        release: Option<unsafe extern "C" fn(*mut c_void)>,
    }
    Column = "osteoflow_column" {
        name: Text,
        data: *const c_void,
        n_rows: u64,
        stride: u64,
        type_: u32,
        width: u32,
        owner: Owner,
    }
    View = "osteoflow_view" { head: *const c_void, head_size: u64, columns: *const Column, n_columns: u64, }
    SchemaEntry = "osteoflow_part" { name: Text, unit: Text, doc: Text, shape: u32, width: u32, type_: u32, flags: u32, }
    Payload = "osteoflow_payload" { name: Text, parts: *const SchemaEntry, n_parts: u64, version: u32, flags: u32, }
    Item = "osteoflow_item" {
        number: u64,
        stamp_ns: i64,
        value: *const Value,
        payload: *const Payload,
        empty_node: Text,
        empty_reason: Text,
    }
    Slot = "osteoflow_slot" { what: u32, flags: u32, items: *const Item, n_items: u64, }
    Firing = "osteoflow_firing" { size: u64, host: *const Host, run: *mut Run, slots: *const Slot, n_slots: u64, }
    Param = "osteoflow_param" { what: u32, boolean: u32, number: f64, text: Text, numbers: Numbers, json: Text, }
    Declared = "osteoflow_declared" { name: Text, payload: *const Payload, params: Text, }
    Host = "osteoflow_host" {
        size: u64,
        view: unsafe extern "C" fn(*const Value, *mut View) -> i32,
        result: unsafe extern "C" fn(*const Value) -> Text,
        hold: unsafe extern "C" fn(*const Value) -> *const Value,
        release: unsafe extern "C" fn(*const Value),
        emit: unsafe extern "C" fn(*mut Run, u64, *const View) -> i32,
        emit_as: unsafe extern "C" fn(*mut Run, u64, Text, u32, *const View) -> i32,
        emit_value: unsafe extern "C" fn(*mut Run, u64, *const Value) -> i32,
        emit_held: unsafe extern "C" fn(*mut Run, u64, *const Value) -> i32,
        emit_empty: unsafe extern "C" fn(*mut Run, u64, Text) -> i32,
        fail: unsafe extern "C" fn(*mut Run, Text, Text),
        node: unsafe extern "C" fn(*const Run) -> Text,
        item: unsafe extern "C" fn(*const Run) -> u64,
        stamp_ns: unsafe extern "C" fn(*const Run) -> i64,
        set_stamp_ns: unsafe extern "C" fn(*mut Run, i64),
        seed: unsafe extern "C" fn(*const Run) -> u64,
        random: unsafe extern "C" fn(*const Run, u64) -> u64,
        clock_ns: unsafe extern "C" fn(*mut Run) -> i64,
        budget: unsafe extern "C" fn(*mut Run, u64) -> *mut Budget,
        budget_is_over: unsafe extern "C" fn(*mut Budget) -> i32,
        budget_release: unsafe extern "C" fn(*mut Budget),
        cancelled: unsafe extern "C" fn(*const Run) -> i32,
        warn: unsafe extern "C" fn(*mut Run, Text),
        absent_reason: unsafe extern "C" fn(*const Run, Text) -> Text,
        out_dir: unsafe extern "C" fn(*const Run) -> Text,
        param: unsafe extern "C" fn(*mut Run, Text, *mut Param),
        n_declared: unsafe extern "C" fn(*const Run) -> u64,
        declared: unsafe extern "C" fn(*const Run, u64, *mut Declared) -> i32,
        log_level: unsafe extern "C" fn() -> u32,
        log: unsafe extern "C" fn(u32, Text, Text),
    }
    Input = "osteoflow_input" {
        name: Text,
        doc: Text,
        payload: Text,
        version: u32,
        flags: u32,
        join: u32,
        join_n: u32,
        join_ns: i64,
        frame: Text,
        to: Text,
        from: Text,
    }
    Output = "osteoflow_output" {
        name: Text,
        doc: Text,
        payload: Text,
        version: u32,
        flags: u32,
        frame: Text,
        to: Text,
        from: Text,
    }
    Kind = "osteoflow_kind" {
        kind: Text,
        doc: Text,
        params_schema: Text,
        example: Text,
        declared_schema: Text,
        literature: *const Text,
        n_literature: u64,
        inputs: *const Input,
        n_inputs: u64,
        outputs: *const Output,
        n_outputs: u64,
        role: u32,
        kept: u32,
        flags: u32,
        reserved: u32,
        data: *const c_void,
        create: Option<unsafe extern "C" fn(*const Kind, *const Firing, Text, *mut *mut c_void) -> i32>,
        fire: Option<unsafe extern "C" fn(*mut c_void, *const Firing) -> i32>,
        destroy: Option<unsafe extern "C" fn(*mut c_void)>,
        max_delay_ns: Option<unsafe extern "C" fn(*mut c_void) -> i64>,
        silent_after_ns: Option<unsafe extern "C" fn(*mut c_void) -> i64>,
    }
    Sizes = "osteoflow_sizes" {
        plugin: u32,
        kind: u32,
        input: u32,
        output: u32,
        payload: u32,
        part: u32,
        host: u32,
        firing: u32,
        slot: u32,
        item: u32,
        view: u32,
        column: u32,
        param: u32,
        declared: u32,
    }
    Plugin = "osteoflow_plugin" {
        magic: [u8; 8],
        abi_major: u32,
        abi_minor: u32,
        sizes: Sizes,
        panic: u32,
        flags: u32,
        name: Text,
        version: Text,
        sdk: Text,
        compiler: Text,
        kinds: *const Kind,
        n_kinds: u64,
        payloads: *const Payload,
        n_payloads: u64,
        start: Option<unsafe extern "C" fn(*const Host)>,
    }
}

/// An opaque value of the program.
#[repr(C)]
#[derive(Debug)]
pub struct Value {
    _opaque: [u8; 0],
}

/// An opaque firing of the program.
#[repr(C)]
#[derive(Debug)]
pub struct Run {
    _opaque: [u8; 0],
}

/// An opaque time budget of the program.
#[repr(C)]
#[derive(Debug)]
pub struct Budget {
    _opaque: [u8; 0],
}

/// The type of the exported function.
pub type DescribeFn = unsafe extern "C" fn() -> *const Plugin;

impl Sizes {
    /// The sizes as this crate was compiled.
    pub const OURS: Self = Self {
        plugin: size_of::<Plugin>() as u32,
        kind: size_of::<Kind>() as u32,
        input: size_of::<Input>() as u32,
        output: size_of::<Output>() as u32,
        payload: size_of::<Payload>() as u32,
        part: size_of::<SchemaEntry>() as u32,
        host: size_of::<Host>() as u32,
        firing: size_of::<Firing>() as u32,
        slot: size_of::<Slot>() as u32,
        item: size_of::<Item>() as u32,
        view: size_of::<View>() as u32,
        column: size_of::<Column>() as u32,
        param: size_of::<Param>() as u32,
        declared: size_of::<Declared>() as u32,
    };
}

impl Text {
    /// A missing text.
    pub const NONE: Self = Self { data: ptr::null(), length: 0 };

    /// Points to the text; valid as long as it is neither moved nor freed.
    pub const fn of(text: &str) -> Self {
        Self { data: text.as_ptr(), length: text.len() as u64 }
    }

    /// Points to the text, or is [`Text::NONE`].
    pub fn of_option(text: Option<&str>) -> Self {
        text.map_or(Self::NONE, Self::of)
    }
}

impl Numbers {
    /// Points to the numbers; valid as long as they are neither moved nor freed.
    pub const fn of(numbers: &[f64]) -> Self {
        Self { data: numbers.as_ptr(), length: numbers.len() as u64 }
    }
}

/// Invalid data from the other side of the boundary.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct AbiError(pub String);

impl AbiError {
    /// A required pointer is null.
    pub fn null(what: impl fmt::Display) -> Self {
        Self(format!("{what} is a null pointer"))
    }

    /// A code is unknown.
    pub fn code(what: impl fmt::Display, code: u32) -> Self {
        Self(format!("{what} has the unknown code {code}"))
    }

    fn length(what: impl fmt::Display, length: u64) -> Self {
        Self(format!("{what} claims {length} entries, more than memory can hold"))
    }

    fn unaligned(what: impl fmt::Display) -> Self {
        Self(format!("{what} is not aligned to its type"))
    }
}
