use super::*;
use std::io::Cursor;

/// A record of this opcode, content and claimed length, and the bytes after it.
fn claimed(opcode: u8, length: u64, content: &[u8], next: &[u8]) -> Vec<u8> {
    [&[opcode], &length.to_le_bytes()[..], content, next].concat()
}

fn record(opcode: u8, content: &[u8], next: &[u8]) -> Vec<u8> {
    claimed(opcode, content.len() as u64, content, next)
}

/// `n` zero bytes, with texts of these lengths behind the first `skipped`.
fn fields(skipped: usize, lengths: &[u32]) -> Vec<u8> {
    let mut bytes = vec![0; skipped];
    for n in lengths {
        bytes.extend(n.to_le_bytes());
        bytes.extend(vec![b'x'; *n as usize]);
    }
    bytes
}

fn message_index(n_entries: u32) -> Vec<u8> {
    fields(2, &[16 * n_entries])
}

fn attachment(n_bytes: u64) -> Vec<u8> {
    let mut bytes = fields(16, &[1, 2]);
    bytes.extend(n_bytes.to_le_bytes());
    bytes.extend([7; 3 + 4]);
    bytes
}

fn chunk(n_packed: u64) -> Vec<u8> {
    let mut bytes = vec![0; 3 * 8 + 4];
    bytes.extend(fields(0, &[4]));
    bytes.extend(n_packed.to_le_bytes());
    bytes.extend([7; 5]);
    bytes
}

fn found(bytes: &[u8]) -> bool {
    is_record(bytes, bytes.len() as u64)
}

#[test]
fn a_record_is_recognised_where_its_lengths_agree_and_another_one_can_follow() {
    let kinds = [
        (op::CHUNK, chunk(5)),
        (op::MESSAGE_INDEX, message_index(2)),
        (op::MESSAGE_INDEX, message_index(3)),
        (op::METADATA, fields(0, &[1, 1])),
        (op::METADATA, fields(0, &[3, 9])),
        (op::ATTACHMENT, attachment(3)),
    ];
    for (opcode, content) in kinds {
        let what = op::name(opcode);
        assert!(found(&record(opcode, &content, &[])), "{what} at the end");
        assert!(found(&record(opcode, &content, &[op::CHUNK])), "{what}");
        assert!(!found(&record(opcode, &content, &[0])), "{what}: no record has opcode 0");
        assert!(!found(&record(opcode, &[&content[..], &[1]].concat(), &[1])), "{what} that is longer than its fields");
        assert!(!found(&claimed(opcode, content.len() as u64 - 1, &content, &[1])), "{what} that is shorter");
        assert!(!found(&record(opcode, &content, &[])[..8]), "{what} without its length");
        let whole = record(opcode, &content, &[]);
        assert!(!is_record(&whole, whole.len() as u64 - 1), "{what} beyond the end of the file");
        assert!(is_record(&whole[..whole.len() - 1], whole.len() as u64), "{what} beyond what is in sight");
    }
}

#[test]
fn zeros_and_lengths_by_chance_are_no_record() {
    let refused = [
        (op::CHUNK, chunk(6)),
        (op::MESSAGE_INDEX, message_index(1)),
        (op::MESSAGE_INDEX, message_index(0)),
        // 33 bytes of entries.
        (op::MESSAGE_INDEX, fields(2, &[33])),
        (op::MESSAGE_INDEX, vec![0; 3]),
        (op::METADATA, fields(0, &[0, 9])),
        (op::METADATA, vec![0; 8]),
        (op::METADATA, vec![1; 3]),
        (op::ATTACHMENT, attachment(2)),
        (op::ATTACHMENT, attachment(u64::MAX)),
        (op::ATTACHMENT, vec![0; 30]),
        (op::SCHEMA, fields(2, &[1, 1, 1])),
        (op::CHANNEL, fields(4, &[1, 1, 1])),
        (op::MESSAGE, vec![1; 30]),
        (0, vec![0; 30]),
        (0x80, vec![1; 30]),
    ];
    for (opcode, content) in refused {
        assert!(!found(&record(opcode, &content, &[1])), "{} of {} bytes", op::name(opcode), content.len());
    }
}

#[test]
fn the_end_of_the_data_is_recognised_by_the_record_behind_it() {
    let end = |next: &[u8]| found(&record(op::DATA_END, &[0; 4], next));
    for opcode in [op::FOOTER, op::SCHEMA, op::DATA_END] {
        assert!(end(&[opcode]), "{opcode}");
    }
    for next in [&[][..], &[0], &[op::HEADER], &[op::DATA_END + 1]] {
        assert!(!end(next), "{next:?}");
    }
    assert!(!found(&record(op::DATA_END, &[0, 0, 0, 0, op::FOOTER], &[op::FOOTER])), "five bytes");
}

#[test]
fn messages_of_known_channels_schemas_and_channels_are_recognised_without_chunks() {
    let known = |id: u16| id == 0x0102;
    let loose = |bytes: &[u8]| is_loose_record(bytes, bytes.len() as u64, &known);
    let message = |n: usize| record(op::MESSAGE, &[&[2, 1][..], &vec![0; n - 2]].concat(), &[]);
    assert!(loose(&message(22)) && loose(&message(23)) && !loose(&message(21)), "22 bytes come before the data");
    assert!(!loose(&record(op::MESSAGE, &[0; 30], &[])), "of another channel");
    assert!(!loose(&record(op::MESSAGE, &[2], &[])));
    for (opcode, n_before) in [(op::SCHEMA, 2), (op::CHANNEL, 4)] {
        let all = |lengths: &[u32]| record(opcode, &fields(n_before, lengths), &[]);
        assert!(loose(&all(&[1, 0, 0])) && loose(&all(&[3, 4, 5])), "{opcode}");
        assert!(!loose(&all(&[0, 0, 0])), "{opcode}: zeros");
        assert!(!loose(&all(&[3, 4])) && !loose(&all(&[3, 4, 5, 6])), "{opcode}: other lengths");
    }
    for opcode in [op::CHUNK, op::METADATA, 0] {
        assert!(!loose(&record(opcode, &fields(0, &[1, 0]), &[])), "{opcode}");
    }
}

fn input(bytes: &[u8]) -> Input<Cursor<&[u8]>> {
    Input::new(Cursor::new(bytes), bytes.len() as u64)
}

#[test]
fn a_record_is_plausible_up_to_a_terabyte_and_one_of_an_application_within_the_file() {
    let plausible = |bytes: &[u8], at: u64| is_plausible(&mut input(bytes), at).unwrap();
    assert!(plausible(&[9; 20], 20) && plausible(&[9; 20], 21), "the end of the file");
    for opcode in 0..=255 {
        let is_known = (op::HEADER..=op::DATA_END).contains(&opcode);
        assert_eq!(plausible(&[9, opcode], 1), is_known, "a cut head with opcode {opcode}");
        assert_eq!(plausible(&[9, opcode, 0, 0, 0, 0, 0, 0, 0], 1), is_known, "eight bytes of opcode {opcode}");
        assert_eq!(plausible(&record(opcode, &[1; 3], &[]), 0), is_known || opcode >= 0x80, "opcode {opcode}");
        assert_eq!(plausible(&claimed(opcode, 4, &[1; 3], &[]), 0), is_known, "opcode {opcode}, cut");
        assert_eq!(plausible(&claimed(opcode, (1 << 40) - 1, &[], &[]), 0), is_known, "opcode {opcode}, long");
        assert!(!plausible(&claimed(opcode, 1 << 40, &[], &[]), 0), "opcode {opcode}, too long");
    }
}

#[test]
fn a_loose_record_is_followed_by_two_plausible_ones_or_the_end() {
    let some = |opcodes: &[u8]| opcodes.iter().flat_map(|opcode| record(*opcode, &[1, 2], &[])).collect::<Vec<u8>>();
    let continue_from = |bytes: &[u8], at: u64| continues(&mut input(bytes), at, 2).unwrap();
    assert!(continue_from(&some(&[5, 5, 5]), 0) && continue_from(&some(&[5, 5, 5, 0]), 0));
    assert!(continue_from(&some(&[0, 5, 5]), 0), "the record itself is not asked");
    assert!(!continue_from(&some(&[5, 0, 5]), 0) && !continue_from(&some(&[5, 5, 0]), 0));
    assert!(continue_from(&some(&[5]), 0) && continue_from(&some(&[5, 5]), 0), "the end of the file");
    assert!(continue_from(&[&some(&[5])[..], &[5]].concat(), 0), "a cut head");
    assert!(!continue_from(&[&some(&[5])[..], &[0]].concat(), 0));
    for length in [100, u64::MAX] {
        assert!(continue_from(&claimed(5, length, &[1; 30], &[]), 0), "a record that goes beyond the end");
    }
    assert!(continue_from(&some(&[5, 5, 0]), 11 + 11 + 3), "within the last bytes");
}

#[test]
fn a_record_is_found_wherever_the_window_ends() {
    let metadata = record(op::METADATA, &fields(0, &[2000, 5]), &[]);
    let n_bytes = 3 * WINDOW as usize;
    let window = WINDOW as usize;
    for at in [
        1,
        100,
        window - SIGHT - 1,
        window - SIGHT,
        window - SIGHT + 1,
        window - 5,
        window,
        2 * window,
        n_bytes - metadata.len(),
    ] {
        let mut bytes = vec![0; n_bytes];
        bytes[at..at + metadata.len()].copy_from_slice(&metadata);
        bytes.get_mut(at + metadata.len()).into_iter().for_each(|next| *next = op::CHUNK);
        let next = |from: usize, bytes: &[u8]| next_record(&mut input(bytes), from as u64, None).unwrap();
        assert_eq!(next(at, &bytes), Some(at as u64));
        assert_eq!(next(1, &bytes), Some(at as u64));
        assert_eq!(next(at + 1, &bytes), None);
        assert_eq!(next(1, &bytes[..at + metadata.len() - 1]), None, "a record that is cut");
    }
    for from in [4, 5, 9, 10, 11] {
        assert_eq!(next_record(&mut input(&[1; 10]), from, None).unwrap(), None, "from {from} of 10 bytes");
    }
}

#[test]
fn loose_records_are_found_only_where_they_are_asked_for_and_others_follow() {
    let message = [&[1, 0][..], &[0; 20]].concat();
    let good = [record(op::MESSAGE, &message, &[]), record(op::MESSAGE, &message, &[])].concat();
    let bytes = [&[0; 7][..], &good].concat();
    let has = |id: u16| id == 1;
    let next = |bytes: &[u8], has: Option<&dyn Fn(u16) -> bool>| next_record(&mut input(bytes), 1, has).unwrap();
    assert_eq!(next(&bytes, Some(&has)), Some(7));
    assert_eq!(next(&bytes, None), None);
    assert_eq!(next(&bytes, Some(&|_| false)), None);
    // What follows the first is no record, so the second is the next one.
    let apart = [&[0; 7][..], &record(op::MESSAGE, &message, &[0; 9]), &good].concat();
    assert_eq!(next(&apart, Some(&has)), Some(7 + 31 + 9));
}
