//! Sessions on a wgpu device that the host application has opened.

use itm_slam::{Device, Mode, Poses, Slam};
use itm_synth::Path;
use itm_tests::{device, sequence, small_map};

#[test]
fn sessions_on_the_hosts_device_find_the_poses_that_one_on_its_own_finds() {
    let Some(own) = device() else { return };
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
    let adapter = pollster::block_on(instance.request_adapter(&wgpu::RequestAdapterOptions::default())).unwrap();
    let (device, queue) = pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor {
        required_features: adapter.features() & wgpu::Features::TIMESTAMP_QUERY,
        required_limits: adapter.limits(),
        ..Default::default()
    }))
    .unwrap();
    let shared = Device::from_wgpu(device.clone(), queue.clone(), &adapter.get_info()).unwrap();
    let sequence = sequence(Path::Arc, (160, 120), 8);
    let start = |device: &Device, mode| {
        Slam::new(device, &sequence.calibration(), &small_map(mode), Poses::Tracked).expect("a session")
    };
    let modes = [Mode::Basic, Mode::Surfels];
    let (mut alone, mut beside) = (modes.map(|mode| start(&own, mode)), modes.map(|mode| start(&shared, mode)));
    for frame in sequence.frames() {
        for slam in alone.iter_mut().chain(&mut beside) {
            slam.process(&frame).expect("a result");
        }
        // The host's own work goes to the same queue.
        queue.submit([device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default()).finish()]);
    }
    for (alone, beside) in alone.iter().zip(&beside) {
        assert_eq!(alone.trajectory().len(), 8);
        // They may have chosen different adapters of several.
        if own.name() == shared.name() {
            assert!(alone.trajectory() == beside.trajectory());
        }
    }
}
