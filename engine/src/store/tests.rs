use super::*;
use osteoflow_node::Value;
use osteoflow_toy::{Number, Samples};
use proptest::prelude::*;
use std::{ffi::OsString, time::Duration};

fn store(max_bytes: u64) -> (Store, tempfile::TempDir) {
    let dir = tempfile::tempdir().unwrap();
    (Store::open(Settings { max_bytes, ..Settings::in_dir(dir.path()) }), dir)
}

fn key(name: &str) -> Key {
    Key::of("test").text("name", name).done()
}

fn files(store: &Store) -> Vec<PathBuf> {
    let mut files: Vec<_> = fs::read_dir(store.dir()).unwrap().map(|file| file.unwrap().path()).collect();
    files.sort();
    files
}

/// Sets the last use of an entry to `seconds` ago.
fn age(store: &Store, key: &Key, seconds: u64) {
    let file = File::options().write(true).open(store.path(key)).unwrap();
    file.set_modified(SystemTime::now() - Duration::from_secs(seconds)).unwrap();
}

#[test]
fn an_entry_is_read_back_and_can_be_replaced() {
    let (store, _dir) = store(1 << 20);
    assert!(store.get(&key("a")).is_none());
    store.put(&key("a"), &[b"one", b"", b"two"]).unwrap();
    assert_eq!(store.get(&key("a")).unwrap().bytes(), b"onetwo");
    store.put(&key("a"), &[]).unwrap();
    assert_eq!(store.get(&key("a")).unwrap().bytes(), b"");
    assert!(store.get(&key("b")).is_none());
    assert_eq!(files(&store).len(), 1);
}

#[test]
fn a_key_depends_on_parts_namespaces_names_and_order() {
    let parts = |space| Key::of(space).text("a", "x").text("b", "yz");
    let others = [
        Key::of("one").text("a", "xy").text("b", "z").done(),
        Key::of("one").text("b", "yz").text("a", "x").done(),
        Key::of("one").text("a", "x").text("c", "yz").done(),
        Key::of("one").text("a", "x").text("b", "yz").text("", "").done(),
        parts("two").done(),
    ];
    assert_eq!(parts("one").done(), parts("one").done());
    assert!(others.iter().all(|other| *other != parts("one").done()));
    let json = |text| Key::of("one").json("params", &serde_json::from_str(text).unwrap()).done();
    assert_eq!(json(r#"{"a": 1, "b": {"c": 2, "d": 3}}"#), json(r#"{"b": {"d": 3, "c": 2}, "a": 1}"#));
    assert_ne!(json(r#"{"a": 1.0}"#), json(r#"{"a": 1.5}"#));
}

#[test]
fn a_payload_is_keyed_by_its_bits() {
    let of = |number: f64| Key::of("test").value("number", &Value::new(Number(number))).done();
    assert_eq!(of(0.5), of(0.5));
    assert_ne!(of(0.0), of(-0.0));
}

#[test]
fn a_payload_borrows_the_bytes_of_its_entry_and_keeps_its_type() {
    let (store, _dir) = store(1 << 20);
    let samples: Vec<f64> = (0..10_000).map(f64::from).collect();
    store.save(&key("wave"), &Samples { label: "µ".into(), samples: samples.clone() }).unwrap();
    let wave = store.load::<Samples, _>(&key("wave")).unwrap();
    assert_eq!((wave.label.as_str(), &wave.samples), ("µ", &samples));
    assert!(store.load::<Number, _>(&key("wave")).is_none());
    let entry = store.get(&key("wave")).unwrap();
    let item = super::payload::decode(&entry, 0..entry.bytes().len()).unwrap();
    let column = item.body.unwrap().columns.remove(0);
    assert!(entry.bytes().as_ptr_range().contains(&column.bytes().as_ptr()), "the rows were copied");
    assert!(matches!(column.rows_of::<f64>().unwrap(), std::borrow::Cow::Borrowed(_)), "the rows are not aligned");
    let far = entry.bytes().len() + 1;
    assert!(super::payload::decode(&entry, 0..far).is_err());
}

#[test]
fn an_entry_with_the_file_name_of_another_is_ignored() {
    let (store, _dir) = store(1 << 20);
    store.put(&key("a"), &[b"of a"]).unwrap();
    fs::copy(store.path(&key("a")), store.path(&key("b"))).unwrap();
    assert!(store.get(&key("b")).is_none());
    store.put(&key("b"), &[b"of b"]).unwrap();
    assert_eq!(store.get(&key("b")).unwrap().bytes(), b"of b");
}

#[test]
fn the_least_recently_used_entry_is_removed_first() {
    let (store, _dir) = store(40_000);
    let (large, names) = (vec![7; 9_000], ["a", "b", "c"]);
    for (at, name) in names.iter().enumerate() {
        store.put(&key(name), &[&large]).unwrap();
        age(&store, &key(name), 300 - 100 * at as u64);
    }
    // Reading it makes it the newest.
    assert!(store.get(&key("a")).is_some());
    fs::write(store.dir().join("notes.txt"), vec![0; 100_000]).unwrap();
    store.put(&key("d"), &[&large]).unwrap();
    let there: Vec<_> = ["a", "b", "c", "d"].into_iter().filter(|name| store.get(&key(name)).is_some()).collect();
    assert_eq!(there, ["a", "c", "d"]);
    assert!(store.dir().join("notes.txt").exists(), "a file that is not of the store was removed");
}

#[test]
fn a_store_stays_below_its_maximum_and_refuses_larger_entries() {
    let (store, _dir) = store(100_000);
    for n in 0..200 {
        store.put(&key(&n.to_string()), &[&vec![n; 5_000]]).unwrap();
        let bytes: u64 = files(&store).iter().map(|file| evict::on_disk(file.metadata().unwrap().len())).sum();
        assert!(bytes <= 100_000, "{bytes} bytes after entry {n}");
    }
    store.put(&key("large"), &[&[1; 200_000]]).unwrap();
    assert!(store.get(&key("large")).is_none());
    assert!(store.get(&key("199")).is_some(), "the newest entry is gone");
}

#[test]
fn concurrent_writers_and_readers_of_one_key_see_whole_entries() {
    let (first, dir) = store(400_000);
    let bytes = |n: u8| vec![n; 50_000];
    first.put(&key("shared"), &[&bytes(0)]).unwrap();
    std::thread::scope(|scope| {
        for n in 0..4 {
            let dir = dir.path();
            scope.spawn(move || {
                // As another process would, share only the folder.
                let store = Store::open(Settings { max_bytes: 400_000, ..Settings::in_dir(dir) });
                for round in 0..50 {
                    store.put(&key("shared"), &[&bytes(n)]).unwrap();
                    store.put(&key(&format!("{n} {round}")), &[&bytes(n)]).unwrap();
                    if let Some(entry) = store.get(&key("shared")) {
                        let first = entry.bytes()[0];
                        assert!(entry.bytes().iter().all(|b| *b == first), "two entries are mixed");
                    }
                }
            });
        }
    });
    assert!(files(&first).iter().all(|file| file.extension().is_some_and(|end| end == "entry")), "something is left");
}

#[test]
fn a_folder_that_cannot_be_created_is_an_error_with_a_next_step() {
    let (_, dir) = store(1 << 20);
    let file = dir.path().join("file");
    fs::write(&file, "").unwrap();
    let store = Store::open(Settings::in_dir(file.join("store")));
    assert!(store.get(&key("a")).is_none());
    let said = store.put(&key("a"), &[b"a"]).unwrap_err().to_string();
    assert!(said.contains("nothing can be kept in the store") && said.contains("OSTEOFLOW_CACHE"), "{said}");
}

#[test]
fn the_environment_sets_folder_and_size() {
    let of = |said: &[(&str, &str)]| {
        Settings::of(|name| said.iter().find(|(n, _)| *n == name).map(|(_, value)| OsString::from(value)))
    };
    let dir = std::env::temp_dir();
    let named = of(&[("OSTEOFLOW_CACHE", dir.to_str().unwrap()), ("OSTEOFLOW_CACHE_MAX_MB", "5")]).unwrap();
    assert_eq!(named, Some(Settings { dir: dir.clone(), max_bytes: 5_000_000 }));
    assert_eq!(of(&[("OSTEOFLOW_CACHE", "off"), ("HOME", "/home/me")]).unwrap(), None);
    assert_eq!(of(&[]).unwrap(), None);
    let wrong = of(&[("OSTEOFLOW_CACHE_MAX_MB", "5 GB")]).unwrap_err().to_string();
    assert!(wrong.contains("OSTEOFLOW_CACHE_MAX_MB is \"5 GB\", but a whole number of megabytes"), "{wrong}");
    if cfg!(target_os = "linux") {
        let dir_of = |said| of(said).unwrap().map(|settings| settings.dir);
        let at_home = Some("/home/me/.cache/osteoflow".into());
        assert_eq!(dir_of(&[("HOME", "/home/me")]), at_home);
        assert_eq!(dir_of(&[("HOME", "/home/me"), ("XDG_CACHE_HOME", "caches"), ("OSTEOFLOW_CACHE", "")]), at_home);
        assert_eq!(dir_of(&[("HOME", "/h"), ("XDG_CACHE_HOME", "/caches")]), Some("/caches/osteoflow".into()));
    }
}

proptest! {
    #[test]
    fn a_damaged_entry_is_ignored_and_replaced(at in 0usize..264, bit in 0u8..8, cut in 0usize..264, longer: bool) {
        let (store, _dir) = store(1 << 20);
        let bytes: Vec<u8> = (0..200).collect();
        store.put(&key("a"), &[&bytes]).unwrap();
        let whole = fs::read(store.path(&key("a"))).unwrap();
        prop_assert_eq!(whole.len(), 264);
        let mut flipped = whole.clone();
        flipped[at] ^= 1 << bit;
        fs::write(store.path(&key("a")), &flipped).unwrap();
        let got = store.get(&key("a"));
        // The padding zeros of the header are not checked.
        prop_assert_eq!(got.is_some(), (56..64).contains(&at), "byte {}, bit {}", at, bit);
        prop_assert!(got.is_none_or(|entry| entry.bytes() == bytes));
        let other = if longer { [&whole[..], &[0]].concat() } else { whole[..cut].to_vec() };
        fs::write(store.path(&key("a")), other).unwrap();
        prop_assert!(store.get(&key("a")).is_none());
        store.put(&key("a"), &[&bytes]).unwrap();
        prop_assert!(store.get(&key("a")).is_some_and(|entry| entry.bytes() == bytes));
    }
}
