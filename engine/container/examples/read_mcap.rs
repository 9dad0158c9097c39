//! Counts the messages of each topic of an MCAP file, whole or damaged: `cargo run --example read_mcap FILE`.
use osteoflow_container::{Damage, Location, MessageHeader, Reader, Record, Visitor, WriteOptions, Writer};
use std::{collections::BTreeMap, env, error::Error, fs::File, ops::ControlFlow, path::PathBuf};

#[derive(Default)]
struct Topics(BTreeMap<u16, (String, usize)>);

impl Visitor for Topics {
    fn record(&mut self, _: Location, record: Record<'_>) -> ControlFlow<()> {
        match record {
            Record::Channel(channel) => self.0.entry(channel.id).or_default().0 = channel.topic,
            Record::Message(message) => self.0.entry(message.channel_id).or_default().1 += 1,
            _ => {}
        }
        ControlFlow::Continue(())
    }

    fn damage(&mut self, damage: Damage) -> ControlFlow<()> {
        println!("lost: {damage:?}");
        ControlFlow::Continue(())
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let path = env::args().nth(1).map_or_else(written, |path| Ok(path.into()))?;
    let mut topics = Topics::default();
    println!("{}: {:?} {:?}", path.display(), Reader::open(&path)?.read(&mut topics)?, topics.0);
    Ok(())
}

fn written() -> Result<PathBuf, Box<dyn Error>> {
    let path = env::temp_dir().join("read_mcap.mcap");
    let mut writer = Writer::new(File::create(&path)?, WriteOptions::default())?;
    let channel_id = writer.add_channel(0, "/hello", "json", &BTreeMap::new())?;
    let header = MessageHeader { channel_id, sequence: 0, log_time: 1, publish_time: 1 };
    writer.write_message(header, b"{}".to_vec().into())?;
    writer.finish()?;
    Ok(path)
}
