//! A host application that has opened a wgpu device of its own, and lets a session compute on it. No other program needs wgpu.
//!
//! ```sh
//! cargo run --release -p itm-tests --example shared_device
//! ```

#![allow(clippy::print_stdout, reason = "this is a program")]

use itm_slam::{Device, Poses, Settings, Slam};
use itm_synth::{Path, Sequence, Spec};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // As an application does that draws. Stages want as many bindings and as large ones as the adapter has.
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
    let adapter = pollster::block_on(instance.request_adapter(&wgpu::RequestAdapterOptions::default()))?;
    let (device, queue) = pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor {
        required_features: adapter.features() & wgpu::Features::TIMESTAMP_QUERY,
        required_limits: adapter.limits(),
        ..Default::default()
    }))?;
    let shared = Device::from_wgpu(device.clone(), queue.clone(), &adapter.get_info())?;

    let sequence = Sequence::new(Spec::new(Path::Arc).with_size(160, 120).with_frames(30))?;
    let mut slam = Slam::new(&shared, &sequence.calibration(), &Settings::default(), Poses::Tracked)?;
    for frame in sequence.frames() {
        slam.process(&frame)?;
        // The application's own work goes to the same queue.
        queue.submit([device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default()).finish()]);
    }
    println!("{}: {} of 30 frames have a pose", shared.name(), slam.trajectory().len());
    Ok(())
}
