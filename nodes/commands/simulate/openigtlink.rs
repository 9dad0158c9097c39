//! A simulated procedure over OpenIGTLink, as a PLUS server would send it.

use crate::app::simulate::laser_number;
use crate::commands::common::{Global, terminal};
use anyhow::{Context, Result, bail};
use clap::ValueEnum;
use osteoflow_formats::openigtlink::{
    Affine, Body, Decoder, Fiducial, Message, Metadata, PixelImage, PolyData, Scalar, Status, device_name,
};
use osteoflow_geometry::{Cloud, Points, Pose, StampNs, nalgebra::Point3};
use osteoflow_simulation::Procedure;
use std::{
    io::{ErrorKind, Read, Write},
    net::{Shutdown, TcpListener, TcpStream},
    thread,
    time::{Duration, Instant},
};

/// How long a client that has all may take to read it.
const LAST_WORDS: Duration = Duration::from_secs(60);

/// How long a client may take to say that it reads header version 2.
const HELLO: Duration = Duration::from_millis(300);

/// The messages in which scans are sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum ScanType {
    /// IMAGE of three float32, x y z, as the drivers of PLUS for depth cameras send it; pixels without a point are zero.
    Image,
    /// POLYDATA: 12 bytes a point.
    Polydata,
    /// POINT: 136 bytes a point.
    Point,
}

/// Waits for one client at a port of the loopback and plays the procedure to it.
pub(super) fn serve(procedure: &Procedure, port: u16, rate: f64, scans: ScanType, global: &Global) -> Result<()> {
    let listener =
        TcpListener::bind(("127.0.0.1", port)).with_context(|| format!("cannot listen at 127.0.0.1:{port}"))?;
    // A program that asked for a free port needs it, quiet or not.
    writeln!(terminal::stderr(), "SIMULATED procedure over OpenIGTLink at {}", listener.local_addr()?)?;
    let (mut stream, peer) = listener.accept()?;
    stream.set_nodelay(true)?;
    let messages = messages(procedure, scans, reads_version_2(&mut stream)?)?;
    let began = Instant::now();
    let first_ns = messages.first().map_or(0, |(stamp_ns, _)| *stamp_ns);
    for (stamp_ns, bytes) in &messages {
        let due = Duration::from_nanos(((stamp_ns - first_ns) as f64 / rate) as u64);
        thread::sleep(due.saturating_sub(began.elapsed()));
        if let Err(error) = stream.write_all(bytes) {
            bail!("{peer} left before the end: {error}");
        }
    }
    finish(&mut stream)?;
    if !global.quiet {
        writeln!(terminal::stderr(), "{} messages sent to {peer}", messages.len())?;
    }
    Ok(())
}

/// Whether the client has sent a message of header version 2, which PLUS takes for a client that reads it: the library 1.11 does not.
fn reads_version_2(stream: &mut TcpStream) -> Result<bool> {
    stream.set_read_timeout(Some(HELLO))?;
    let mut hello = [0; 1024];
    let n = match stream.read(&mut hello) {
        Ok(n) => n,
        Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => 0,
        Err(error) => return Err(error.into()),
    };
    let mut decoder = Decoder::default();
    decoder.push(&hello[..n]);
    Ok(decoder.flatten().any(|message| message.extended.is_some()))
}

/// Lets the client read what was sent: a socket that is closed with unread bytes discards what it has not yet sent.
fn finish(stream: &mut TcpStream) -> Result<()> {
    stream.shutdown(Shutdown::Write)?;
    stream.set_read_timeout(Some(Duration::from_millis(200)))?;
    let until = Instant::now() + LAST_WORDS;
    let mut unread = [0; 1024];
    while Instant::now() < until {
        match stream.read(&mut unread) {
            Ok(0) => break,
            Ok(_) => {}
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
            Err(_) => break,
        }
    }
    Ok(())
}

/// All messages in the order of their stamps; metadata where header version 2 is read.
fn messages(procedure: &Procedure, scans: ScanType, is_version_2: bool) -> Result<Vec<(StampNs, Vec<u8>)>> {
    let mut messages = Vec::new();
    for pose in procedure.camera_marker.iter().chain(&procedure.phantom_marker).chain(&procedure.bone_marker) {
        messages.push(transform(pose));
    }
    let scan = |device: &str, cloud: &Cloud| {
        let points = cloud.points().iter().map(single);
        let body = match scans {
            ScanType::Image => Body::Image(point_image(&points.collect::<Vec<_>>())),
            ScanType::Polydata => Body::PolyData(PolyData::of_points(points.collect())),
            ScanType::Point => Body::Points(points.map(|point| Fiducial::new("", point)).collect()),
        };
        Message::new(device, cloud.stamp_ns, body)
    };
    messages.push(scan("PhantomScan", &procedure.phantom_scan));
    messages.push(scan("Scan", &procedure.scan));
    for (k, cloud) in procedure.laser.iter().enumerate() {
        messages.push(scan(&format!("LaserP{}", laser_number(procedure, k)), cloud));
    }
    for (device, points) in [("StylusInit", &procedure.stylus_init), ("StylusAssessment", &procedure.stylus_assessment)]
    {
        messages.extend(touches(device, points));
    }
    messages.sort_by_key(|message| message.stamp_ns);
    let first_ns = messages.first().map_or(0, |message| message.stamp_ns);
    let last_ns = messages.last().map_or(0, |message| message.stamp_ns);
    let mut head = vec![Message::new("Simulated", first_ns, Body::Text("true".into()))];
    if let Some(region) = &procedure.region {
        let corners =
            [("min", &region.min), ("max", &region.max)].map(|(name, corner)| Fiducial::new(name, single(corner)));
        head.push(Message::new("RegionOfInterest", first_ns, Body::Points(corners.into())));
    }
    let exiting = Status::new(Status::EXITING, "Exiting", "the simulated procedure is over");
    let tail = Message::new("Simulation", last_ns, Body::Status(exiting));
    let all = head.into_iter().chain(messages).chain([tail]);
    let readable = |mut message: Message| {
        message.extended = message.extended.filter(|_| is_version_2);
        Ok((message.stamp_ns, message.to_bytes()?))
    };
    all.map(readable).collect()
}

/// A pose as PLUS sends it.
fn transform(pose: &Pose) -> Message {
    let metadata = vec![Metadata::new("TransformValid", "True"), Metadata::new("TransformStatus", "OK")];
    Message::new(
        device_name(pose.to.as_str(), pose.from.as_str()),
        pose.stamp_ns,
        Body::Transform(Affine::of(&pose.isometry)),
    )
    .extended(0, metadata)
}

fn touches(device: &str, points: &Points) -> Vec<Message> {
    let touch = |point: &osteoflow_geometry::NamedPoint| {
        let fiducial = Fiducial::new(&*point.name, single(&point.position));
        Message::new(device, point.stamp_ns, Body::Points(vec![fiducial]))
    };
    points.points.iter().map(touch).collect()
}

/// A point image that is about as wide as high; the pixels that are left in its last row are zero.
fn point_image(points: &[[f32; 3]]) -> PixelImage {
    let width = points.len().isqrt().max(1);
    let height = points.len().div_ceil(width).max(1);
    let empty = std::iter::repeat_n([0.0; 3], width * height - points.len());
    let pixels = points.iter().copied().chain(empty).flatten().flat_map(f32::to_le_bytes).collect();
    // Even the largest scan of a simulation has 65535 rows or fewer: four billion points.
    let size = [width, height].map(|n| u16::try_from(n).unwrap_or(u16::MAX));
    PixelImage::new(size, 3, Scalar::F32, pixels)
}

fn single(point: &Point3<f64>) -> [f32; 3] {
    [0, 1, 2].map(|k| point[k] as f32)
}
