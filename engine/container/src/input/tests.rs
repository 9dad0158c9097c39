use super::*;
use std::io::Cursor;

#[test]
fn bytes_are_read_where_they_are_asked_for_in_any_order() {
    // Longer than the buffer.
    let bytes: Vec<u8> = (0..200_000_u32).map(|k| (k.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    let mut input = Input::new(Cursor::new(&bytes), bytes.len() as u64);
    assert_eq!(input.n_bytes(), 200_000);
    let mut out = vec![1, 2, 3];
    for (at, n) in [(0, 10), (10, 70_000), (5, 3), (150_000, 50_000), (70_010, 1), (200_000, 0), (0, 200_000)] {
        assert_eq!(input.read(at, n).unwrap(), bytes[at as usize..(at + n) as usize], "{n} bytes at {at}");
        input.read_into(at, n, &mut out).unwrap();
        assert_eq!(out, bytes[at as usize..(at + n) as usize]);
        let mut crc = crc32fast::Hasher::new();
        input.hash(at, at + n, &mut crc).unwrap();
        assert_eq!(crc.finalize(), crc32fast::hash(&bytes[at as usize..(at + n) as usize]), "{n} bytes at {at}");
        assert_eq!(input.array::<4>(at / 2).unwrap(), bytes[at as usize / 2..at as usize / 2 + 4]);
        let (opcode, length) = input.head(at / 3).unwrap();
        let head = &bytes[at as usize / 3..at as usize / 3 + 9];
        assert_eq!((opcode, length.to_le_bytes()), (head[0], head[1..].try_into().unwrap()));
    }
}

#[test]
fn a_file_that_has_become_shorter_is_an_error() {
    let mut input = Input::new(Cursor::new([7; 10]), 20);
    let ended = |result: io::Result<()>| result.unwrap_err().kind() == io::ErrorKind::UnexpectedEof;
    assert!(ended(input.read(5, 6).map(drop)));
    assert!(ended(input.array::<3>(8).map(drop)));
    assert!(ended(input.hash(0, 11, &mut crc32fast::Hasher::new())));
}
