//! Choosing adapters, and taking over a host application's device.

mod common;

use itm_core::{Calibration, DepthConversion, DepthImage, Frame, Image, Intrinsics, Timestamp};
use itm_gpu::view::{ViewOptions, ViewStage};
use itm_gpu::{Device, Error, Recorder, View};

#[test]
fn adapters_are_listed_best_first_and_found_by_number_and_name() {
    let Some(device) = common::device() else { return };
    let adapters = Device::adapters();
    assert!(adapters.is_sorted_by_key(|a| a.kind));
    let first_fit = adapters.iter().position(|a| a.unfit.is_none()).expect("one was opened");
    assert_eq!(device.name(), adapters[first_fit].name);
    assert_eq!(Device::open(&first_fit.to_string()).unwrap().name(), device.name());
    let part: String = device.name().to_uppercase().chars().take(4).collect();
    assert!(Device::open(&part).is_ok(), "any case will do: {part}");
}

#[test]
fn an_adapter_that_is_not_there_is_refused_with_those_that_are() {
    let Some(device) = common::device() else { return };
    for wanted in ["no such adapter", "99"] {
        let error = Device::open(wanted).unwrap_err();
        assert!(matches!(error, Error::NoSuchAdapter { .. }), "{error}");
        let text = error.to_string();
        assert!(text.contains(wanted) && text.contains(device.name()), "{text}");
    }
}

#[test]
fn a_hosts_own_device_runs_the_stages() {
    if common::device().is_none() {
        return;
    }
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    descriptor.backends = wgpu::Backends::VULKAN | wgpu::Backends::METAL | wgpu::Backends::DX12;
    let instance = wgpu::Instance::new(descriptor);
    let adapter = pollster::block_on(instance.request_adapter(&wgpu::RequestAdapterOptions::default())).unwrap();
    // The default limits, as a host that knows nothing of itm asks for them.
    let (device, queue) = pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor::default())).unwrap();
    let shared = Device::from_wgpu(device.clone(), queue, &adapter.get_info()).unwrap();

    let camera = Intrinsics::new(5, 3, 5.0, 5.0, 2.0, 1.0);
    let calibration = Calibration::registered(camera, DepthConversion::MILLIMETRES);
    let options = ViewOptions {
        depth_range_m: [0.2, 3.0],
        bilateral_passes: 0,
        levels: 1,
        vertices: None,
        observation_weights: false,
        colour_levels: 1,
    };
    let mut view = View::new(&shared, &calibration, &options);
    let frame = Frame::new(0, Timestamp(0), DepthImage::Raw(Image::filled(5, 3, 1500)), None);
    let mut recorder = Recorder::new(&shared);
    ViewStage::new(&shared).record(&mut recorder, &mut view, &frame, &options).unwrap();
    let _untimed = recorder.submit();
    assert!(view.read_depth(&shared, 0).unwrap().data().iter().all(|z| (z - 1.5).abs() < 1e-6));
}
