use super::*;

fn text(text: &str) -> Vec<u8> {
    [&(text.len() as u32).to_le_bytes()[..], text.as_bytes()].concat()
}

fn run(bytes: &[u8]) -> Vec<u8> {
    [&(bytes.len() as u32).to_le_bytes()[..], bytes].concat()
}

fn n(number: u64) -> Vec<u8> {
    number.to_le_bytes().to_vec()
}

fn n4(number: u32) -> Vec<u8> {
    number.to_le_bytes().to_vec()
}

fn n2(number: u16) -> Vec<u8> {
    number.to_le_bytes().to_vec()
}

fn map() -> Vec<u8> {
    run(&[text("k"), text("v"), text("key"), text("")].concat())
}

/// One record of each opcode, its debug text, and whether bytes may follow its last field.
fn each() -> Vec<(u8, Vec<u8>, &'static str, bool)> {
    vec![
        (op::HEADER, [text("ros2"), text("lib")].concat(), "Header { profile: \"ros2\" }", true),
        (op::FOOTER, [n(7), n(8), n4(9)].concat(), "Footer { summary_start: 7, crc: 9, computed: None }", false),
        (
            op::SCHEMA,
            [n2(3), text("Cloud"), text("text"), run(&[1, 2])].concat(),
            "Schema { id: 3, name: \"Cloud\", encoding: \"text\", data: [1, 2] }",
            false,
        ),
        (
            op::CHANNEL,
            [n2(2), n2(3), text("/scan"), text("raw"), map()].concat(),
            "Channel(Channel { id: 2, schema_id: 3, topic: \"/scan\", message_encoding: \"raw\", metadata: {\"k\": \"v\", \
             \"key\": \"\"} })",
            false,
        ),
        (
            op::MESSAGE,
            [n2(2), n4(4), n(5), n(6), vec![7, 8]].concat(),
            "Message(Message { channel_id: 2, sequence: 4, log_time: 5, publish_time: 6, data: [7, 8] })",
            true,
        ),
        (
            op::MESSAGE_INDEX,
            [n2(2), run(&[n(10), n(11), n(12), n(13)].concat())].concat(),
            "MessageIndex { channel_id: 2, entries: [(10, 11), (12, 13)] }",
            false,
        ),
        (
            op::CHUNK_INDEX,
            [n(1), n(2), n(3), n(4), run(&[9; 20]), n(5), text("zstd"), n(6), n(7)].concat(),
            "ChunkIndex(ChunkIndex { start_time: 1, end_time: 2, offset: 3, length: 4, compression: \"zstd\", n_packed: 6, \
             n_unpacked: 7 })",
            true,
        ),
        (
            op::ATTACHMENT,
            [n(1), n(2), text("a.txt"), text("text/plain"), n(3), vec![7, 8, 9], n4(0)].concat(),
            "Attachment(Attachment { log_time: 1, create_time: 2, name: \"a.txt\", media_type: \"text/plain\", data: [7, 8, 9] })",
            false,
        ),
        (
            op::STATISTICS,
            [n(1), n2(2), n4(3), n4(4), n4(5), n4(6), n(7), n(8), run(&[n2(1), n(9), n2(2), n(10)].concat())].concat(),
            "Statistics(Statistics { n_messages: 1, n_schemas: 2, n_channels: 3, n_attachments: 4, n_metadata: 5, n_chunks: \
             6, by_channel: {1: 9, 2: 10} })",
            true,
        ),
        (
            op::METADATA,
            [text("calibration"), map()].concat(),
            "Metadata { name: \"calibration\", entries: {\"k\": \"v\", \"key\": \"\"} }",
            false,
        ),
        (op::METADATA_INDEX, [n(1), n(2), text("a")].concat(), "MetadataIndex { offset: 1, name: \"a\" }", true),
        (op::DATA_END, n4(5), "DataEnd { crc: 5, computed: None }", false),
        (op::ATTACHMENT_INDEX, vec![1], "Other", true),
        (op::SUMMARY_OFFSET, vec![], "Other", true),
        (0x80, vec![1, 2], "Other", true),
    ]
}

#[test]
fn every_record_is_parsed_into_its_fields() {
    for (opcode, body, expected, _) in each() {
        assert_eq!(format!("{:?}", parse(opcode, &body).unwrap()), expected, "{}", op::name(opcode));
    }
}

#[test]
fn a_record_that_is_cut_or_too_long_is_malformed() {
    for (opcode, body, expected, may_be_longer) in each() {
        let what = op::name(opcode);
        if expected != "Other" {
            // A message may end anywhere behind its header.
            let n_cuts = if opcode == op::MESSAGE { 22 } else { body.len() };
            for cut in 0..n_cuts {
                let said = parse(opcode, &body[..cut]).unwrap_err().to_string();
                assert!(said.starts_with(&format!("{what}: ")), "{what} cut at {cut}: {said}");
            }
        }
        let longer = [&body[..], &[0; 3]].concat();
        let longer = parse(opcode, &longer);
        match may_be_longer {
            true => assert!(longer.is_ok(), "{what}"),
            false => assert_eq!(longer.unwrap_err().to_string(), format!("{what}: 3 bytes follow its last field")),
        }
    }
}

#[test]
fn a_field_beyond_the_end_is_named_with_its_place() {
    let said = |opcode: u8, body: &[u8]| parse(opcode, body).unwrap_err().to_string();
    assert_eq!(
        said(op::DATA_END, &[1, 2]),
        "data end: a field of 4 bytes at its byte 0 goes beyond its end, 2 are left"
    );
    let schema = [n2(3), n4(9), vec![b'x'; 8]].concat();
    assert_eq!(said(op::SCHEMA, &schema), "schema: a field of 9 bytes at its byte 6 goes beyond its end, 8 are left");
    assert_eq!(said(op::HEADER, &run(&[0xff])), "header: a text is not UTF-8");
    let twice = [text("a"), run(&[text("k"), text("1"), text("k"), text("2")].concat())].concat();
    assert_eq!(said(op::METADATA, &twice), "metadata: a key stands twice in a map");
    let half = [text("a"), run(&text("k"))].concat();
    assert_eq!(said(op::METADATA, &half), "metadata: a field of 4 bytes at its byte 5 goes beyond its end, 0 are left");
    let statistics = [vec![0; 26 + 16], run(&[0; 11])].concat();
    assert_eq!(said(op::STATISTICS, &statistics), "statistics: its counts by channel end within an entry");
    let index = [n2(1), run(&[0; 17])].concat();
    assert_eq!(
        said(op::MESSAGE_INDEX, &index),
        "message index: a field of 8 bytes at its byte 16 goes beyond its end, 1 are left"
    );
}

#[test]
fn the_crc_of_an_attachment_is_of_everything_before_it_and_zero_is_none() {
    let mut body = [n(1), n(2), text("a.txt"), text("text/plain"), n(3), vec![7, 8, 9]].concat();
    let crc = crc32fast::hash(&body);
    body.extend(n4(crc));
    assert!(parse(op::ATTACHMENT, &body).is_ok());
    let at = body.len() - 4;
    body[at..].copy_from_slice(&5_u32.to_le_bytes());
    let said = parse(op::ATTACHMENT, &body).unwrap_err().to_string();
    assert_eq!(
        said,
        format!("the CRC of the attachment is {crc:08x}, but 00000005 was recorded, so bytes have changed")
    );
    assert_eq!(check_crc("x", 0, 7), Ok(()));
    assert_eq!(check_crc("x", 7, 7), Ok(()));
    assert_eq!(check_crc("x", 7, 0), Err(Cause::Crc { what: "x", stored: 7, computed: 0 }));
}

#[test]
fn the_header_of_a_chunk_has_its_sizes_and_agrees_with_its_record() {
    let bytes = [n(1), n(2), n(300), n4(4), text("lz4"), n(50)].concat();
    let n_fields = 8 * 3 + 4 + 7 + 8;
    assert_eq!(bytes.len(), n_fields);
    let expected = ChunkHeader {
        start_time: 1,
        end_time: 2,
        n_unpacked: 300,
        crc: 4,
        compression: "lz4".into(),
        n_packed: 50,
        n_head: 9 + n_fields as u64,
        n_record: 9 + n_fields as u64 + 50,
    };
    assert_eq!(chunk_header(&bytes, n_fields as u64 + 50), Ok(expected));
    let said = chunk_header(&bytes, 94).unwrap_err().to_string();
    assert_eq!(said, "chunk: its record claims 94 bytes, but its header 43 and its records 50");
    let endless = [n(1), n(2), n(300), n4(4), text("lz4"), n(u64::MAX)].concat();
    assert!(chunk_header(&endless, 42).is_err());
}

#[test]
fn every_opcode_has_a_name() {
    let names: Vec<_> = (0..=0x10).map(op::name).collect();
    let expected = [
        "unknown record",
        "header",
        "footer",
        "schema",
        "channel",
        "message",
        "chunk",
        "message index",
        "chunk index",
        "attachment",
        "attachment index",
        "statistics",
        "metadata",
        "metadata index",
        "summary offset",
        "data end",
        "unknown record",
    ];
    assert_eq!(names, expected);
}
