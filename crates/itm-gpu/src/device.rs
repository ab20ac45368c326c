//! Adapters and the opened device.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};

use itm_core::voxel::VoxelKind;

use crate::Error;

/// Kind of an adapter, best first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum AdapterKind {
    /// A graphics card of its own.
    Discrete,
    /// A GPU that shares the processor's memory.
    Integrated,
    /// A GPU of a virtual machine's host.
    Virtual,
    /// Not said by the driver.
    Other,
    /// The processor itself, through a driver such as lavapipe.
    Software,
}

impl std::fmt::Display for AdapterKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(match self {
            Self::Discrete => "discrete GPU",
            Self::Integrated => "integrated GPU",
            Self::Virtual => "virtual GPU",
            Self::Other => "unknown kind",
            Self::Software => "software",
        })
    }
}

/// What is known of an adapter without opening it.
#[derive(Clone, Debug)]
pub struct AdapterReport {
    /// Name as the driver gives it.
    pub name: String,
    /// What it is.
    pub kind: AdapterKind,
    /// API: Vulkan, Metal, Dx12.
    pub backend: String,
    /// Driver and its version.
    pub driver: String,
    /// Largest buffer that a shader can read, in bytes.
    pub max_binding_bytes: u64,
    /// Storage buffers that a shader can have.
    pub max_storage_buffers: u32,
    /// Largest workgroup.
    pub max_workgroup: u32,
    /// Blocks that the largest map can hold (512 voxels each), by the binding limits; memory may set a lower one.
    pub max_blocks: u64,
    /// Whether stages can be timed on the device.
    pub timestamps: bool,
    /// Why it cannot run itm, if so.
    pub unfit: Option<String>,
}

/// What stages need to know of the device, decided once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Capabilities {
    /// Whether the processor itself computes: then small workgroups with long loops are the fast ones.
    pub software: bool,
    /// Largest buffer that a shader can bind, in bytes.
    pub max_binding_bytes: u64,
    /// Pages that the raycast can bind at once.
    pub max_pages: u32,
    /// Whether stages are timed on the device.
    pub timestamps: bool,
}

/// The storage buffers of the widest pass that every adapter must offer, and the raycast's beside its pages.
const NEEDED_STORAGE_BUFFERS: u32 = 8;
const RAYCAST_OTHER_BUFFERS: u32 = 3;
const LARGEST_RAYCAST_VARIANT: u32 = 4;
const NEEDED_WORKGROUP: u32 = 256;

impl Capabilities {
    fn new(limits: &wgpu::Limits, kind: AdapterKind, timestamps: bool) -> Self {
        Self {
            software: kind == AdapterKind::Software,
            // Shaders count bytes, and words, in 32 bits.
            max_binding_bytes: limits.max_storage_buffer_binding_size.min(limits.max_buffer_size).min(1 << 31),
            max_pages: limits
                .max_storage_buffers_per_shader_stage
                .saturating_sub(RAYCAST_OTHER_BUFFERS)
                .clamp(1, LARGEST_RAYCAST_VARIANT),
            timestamps,
        }
    }

    /// Blocks in a full page of voxels of a kind, as a power of two: its widest plane fits one binding.
    pub fn page_shift(&self, kind: VoxelKind) -> u32 {
        let block_bytes = crate::map::BLOCK_BYTES * kind.distance_words() as u64;
        (self.max_binding_bytes / block_bytes).max(1).ilog2()
    }

    /// Blocks that the largest map of voxels of a kind can hold.
    pub fn max_blocks(&self, kind: VoxelKind) -> u64 {
        u64::from(self.max_pages) << self.page_shift(kind)
    }
}

/// An opened device. Cheap to clone; clones share it.
#[derive(Clone, Debug)]
pub struct Device {
    pub(crate) device: wgpu::Device,
    pub(crate) queue: wgpu::Queue,
    name: String,
    capabilities: Capabilities,
    shared: Arc<Shared>,
}

#[derive(Debug, Default)]
struct Shared {
    /// Uniform buffers that no recorder uses at the moment.
    uniforms: Mutex<Vec<wgpu::Buffer>>,
    /// The first error that the driver reported outside of a call.
    error: Mutex<Option<(bool, String)>>,
    /// Whether stages are waited for one by one.
    paced: AtomicBool,
    /// Whether nothing is submitted for the time being, and who waits for that to end.
    held: Mutex<bool>,
    released: Condvar,
}

fn instance() -> wgpu::Instance {
    // GL is left out: on machines with a software driver it shows up as a second, lesser adapter.
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    descriptor.backends = wgpu::Backends::VULKAN | wgpu::Backends::METAL | wgpu::Backends::DX12;
    wgpu::Instance::new(descriptor)
}

fn kind_of(info: &wgpu::AdapterInfo) -> AdapterKind {
    match info.device_type {
        wgpu::DeviceType::DiscreteGpu => AdapterKind::Discrete,
        wgpu::DeviceType::IntegratedGpu => AdapterKind::Integrated,
        wgpu::DeviceType::VirtualGpu => AdapterKind::Virtual,
        wgpu::DeviceType::Cpu => AdapterKind::Software,
        wgpu::DeviceType::Other => AdapterKind::Other,
    }
}

/// All adapters, best first, the driver's order among equals.
fn sorted_adapters() -> Vec<wgpu::Adapter> {
    let mut adapters = pollster::block_on(instance().enumerate_adapters(wgpu::Backends::all()));
    adapters.sort_by_key(|a| kind_of(&a.get_info()));
    adapters
}

fn check_limits(name: &str, limits: &wgpu::Limits) -> Result<(), Error> {
    let checks = [
        (
            "storage buffers for a shader",
            limits.max_storage_buffers_per_shader_stage.into(),
            NEEDED_STORAGE_BUFFERS.into(),
        ),
        ("invocations for a workgroup", limits.max_compute_invocations_per_workgroup.into(), NEEDED_WORKGROUP.into()),
        ("bytes for a storage buffer", limits.max_storage_buffer_binding_size, 16 << 20),
    ];
    for (what, found, needed) in checks {
        let found: u64 = found;
        if found < needed {
            return Err(Error::AdapterTooSmall { adapter: name.into(), what, found, needed });
        }
    }
    Ok(())
}

const ADVICE: &str = if cfg!(target_os = "linux") {
    "On Debian or Ubuntu, `apt-get install mesa-vulkan-drivers` brings drivers for most GPUs and a software driver for \
     machines without one; on Fedora the package is mesa-vulkan-drivers, on Arch vulkan-swrast or your GPU's vulkan \
     package. For NVIDIA cards install NVIDIA's driver."
} else if cfg!(target_os = "windows") {
    "Install your graphics card's driver; DirectX 12 or Vulkan is needed."
} else {
    "Metal, Vulkan or DirectX 12 is needed."
};

impl Device {
    /// Reports all adapters, best first; an adapter's place in the list is the number that [`Device::open`] takes.
    pub fn adapters() -> Vec<AdapterReport> {
        sorted_adapters()
            .iter()
            .map(|adapter| {
                let (info, limits) = (adapter.get_info(), adapter.limits());
                let kind = kind_of(&info);
                let timestamps = adapter.features().contains(wgpu::Features::TIMESTAMP_QUERY);
                let capabilities = Capabilities::new(&limits, kind, timestamps);
                AdapterReport {
                    name: info.name.clone(),
                    kind,
                    backend: format!("{:?}", info.backend),
                    driver: format!("{} {}", info.driver, info.driver_info).trim().to_string(),
                    max_binding_bytes: capabilities.max_binding_bytes,
                    max_storage_buffers: limits.max_storage_buffers_per_shader_stage,
                    max_workgroup: limits.max_compute_invocations_per_workgroup,
                    max_blocks: capabilities.max_blocks(VoxelKind::default()),
                    timestamps,
                    unfit: check_limits(&info.name, &limits).err().map(|e| e.to_string()),
                }
            })
            .collect()
    }

    /// Opens an adapter: `auto` for the best one, a number from [`Device::adapters`], or a part of its name or driver
    /// (in any case).
    ///
    /// # Errors
    /// Where there is none, none that fits, or the driver refuses.
    pub fn open(wanted: &str) -> Result<Self, Error> {
        let adapter = Self::choose(sorted_adapters(), wanted)?;
        let info = adapter.get_info();
        let (device, queue) = pollster::block_on(adapter.request_device(&Self::descriptor(&adapter)))
            .map_err(|source| Error::Open { adapter: info.name.clone(), source: Box::new(source) })?;
        Self::from_wgpu(device, queue, &info)
    }

    /// The adapter that [`Device::open`] opens, among those that a host application has found.
    ///
    /// # Errors
    /// As [`Device::open`], but for the driver's.
    pub fn choose(mut adapters: Vec<wgpu::Adapter>, wanted: &str) -> Result<wgpu::Adapter, Error> {
        adapters.sort_by_key(|adapter| kind_of(&adapter.get_info()));
        let wanted_lower = wanted.to_lowercase();
        let place = if wanted_lower == "auto" {
            let fits = |adapter: &wgpu::Adapter| check_limits(&adapter.get_info().name, &adapter.limits()).is_ok();
            // None fits: taking the first says why.
            adapters.iter().position(fits).or((!adapters.is_empty()).then_some(0))
        } else if let Ok(number) = wanted.parse::<usize>() {
            (number < adapters.len()).then_some(number)
        } else {
            adapters.iter().position(|adapter| {
                let info = adapter.get_info();
                format!("{} {} {}", info.name, info.driver, info.driver_info).to_lowercase().contains(&wanted_lower)
            })
        };
        let Some(place) = place else {
            if adapters.is_empty() {
                return Err(Error::NoAdapter { advice: ADVICE });
            }
            let names = adapters.iter().enumerate().map(|(i, a)| format!("{i}: {}", a.get_info().name));
            return Err(Error::NoSuchAdapter { wanted: wanted.into(), found: names.collect::<Vec<_>>().join(", ") });
        };
        let adapter = adapters.swap_remove(place);
        check_limits(&adapter.get_info().name, &adapter.limits())?;
        Ok(adapter)
    }

    /// What a device of an adapter is opened with, so that it can run the stages.
    pub fn descriptor(adapter: &wgpu::Adapter) -> wgpu::DeviceDescriptor<'static> {
        wgpu::DeviceDescriptor {
            label: Some("itm"),
            required_features: adapter.features() & wgpu::Features::TIMESTAMP_QUERY,
            required_limits: adapter.limits(),
            memory_hints: wgpu::MemoryHints::MemoryUsage,
            ..Default::default()
        }
    }

    /// Takes over a host application's own device and queue. `info` is its adapter's.
    ///
    /// # Errors
    /// Where the device was opened with limits too low to run the stages.
    pub fn from_wgpu(device: wgpu::Device, queue: wgpu::Queue, info: &wgpu::AdapterInfo) -> Result<Self, Error> {
        check_limits(&info.name, &device.limits())?;
        let timestamps = device.features().contains(wgpu::Features::TIMESTAMP_QUERY);
        let capabilities = Capabilities::new(&device.limits(), kind_of(info), timestamps);
        let shared = Arc::new(Shared::default());
        let (on_error, on_loss) = (Arc::clone(&shared), Arc::clone(&shared));
        device.on_uncaptured_error(Arc::new(move |error| {
            let out_of_memory = matches!(error, wgpu::Error::OutOfMemory { .. });
            if is_of_window(&error) {
                // Nothing of the stages is lost, and the window tries again.
                tracing::debug!(%error, "a surface was not configured");
                return;
            }
            on_error.report(out_of_memory, error.to_string());
        }));
        device.set_device_lost_callback(move |reason, message| {
            // Dropping the device is no loss.
            if reason != wgpu::DeviceLostReason::Destroyed {
                on_loss.report(false, message);
            }
        });
        tracing::debug!(adapter = info.name, ?capabilities, "opened a device");
        Ok(Self { device, queue, name: info.name.clone(), capabilities, shared })
    }

    /// The adapter's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// What the device can do.
    pub fn capabilities(&self) -> &Capabilities {
        &self.capabilities
    }

    /// Whether stages are submitted one by one, each once the one before has been done, so that what another thread
    /// submits meanwhile waits for one stage at most and not for a frame: for a window that draws on a software driver, whose
    /// one queue serves both. What is computed is the same.
    pub fn set_paced(&self, paced: bool) {
        self.shared.paced.store(paced, Ordering::Relaxed);
    }

    /// Whether nothing is submitted until further notice; other threads that would submit wait. Once this returns, all
    /// that was submitted has been done. For a window whose surface is about to be configured: that fails while anything is
    /// under way. An error of the device stays noted for the next check.
    pub fn hold(&self, hold: bool) {
        *self.shared.held.lock().unwrap_or_else(PoisonError::into_inner) = hold;
        if hold {
            let _noted = self.wait();
        } else {
            self.shared.released.notify_all();
        }
    }

    /// Submits what was recorded, once nothing is held.
    pub(crate) fn submit(&self, recorded: wgpu::CommandBuffer) {
        let held = self.shared.held.lock().unwrap_or_else(PoisonError::into_inner);
        // Submitting under the lock: who holds does not miss what was submitted just before.
        let _held = self.shared.released.wait_while(held, |held| *held).unwrap_or_else(PoisonError::into_inner);
        self.queue.submit([recorded]);
    }

    pub(crate) fn is_paced(&self) -> bool {
        self.shared.paced.load(Ordering::Relaxed)
    }

    /// Waits until everything submitted has been done.
    ///
    /// # Errors
    /// Where the device was lost or ran out of memory, now or since the last check.
    pub fn wait(&self) -> Result<(), Error> {
        if let Err(error) = self.device.poll(wgpu::PollType::wait_indefinitely()) {
            self.shared.report(false, error.to_string());
        }
        self.check()
    }

    /// Whether the device has been lost or run out of memory.
    ///
    /// # Errors
    /// If so.
    pub fn check(&self) -> Result<(), Error> {
        let error = self.shared.error.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        match &*error {
            None => Ok(()),
            Some((true, reason)) => Err(Error::OutOfMemory { reason: reason.clone() }),
            Some((false, reason)) => Err(Error::DeviceLost { reason: reason.clone() }),
        }
    }

    /// A storage buffer that starts zeroed. Never empty: a binding needs at least one element.
    pub(crate) fn storage(&self, label: &str, bytes: u64) -> wgpu::Buffer {
        self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size: bytes.next_multiple_of(16).max(16),
            usage: wgpu::BufferUsages::STORAGE
                | wgpu::BufferUsages::COPY_SRC
                | wgpu::BufferUsages::COPY_DST
                | wgpu::BufferUsages::INDIRECT,
            mapped_at_creation: false,
        })
    }

    /// Makes `buffer` hold at least `bytes`, with a quarter more where it has to be made anew, which loses its content.
    pub(crate) fn ensure(&self, buffer: &mut wgpu::Buffer, label: &str, bytes: u64) {
        if buffer.size() < bytes {
            let limit = self.capabilities.max_binding_bytes.max(bytes);
            *buffer = self.storage(label, (bytes + bytes / 4).min(limit));
        }
    }

    /// A buffer that the host can read.
    pub(crate) fn staging(&self, label: &str, bytes: u64) -> wgpu::Buffer {
        self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size: bytes,
            usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        })
    }

    /// Reads the first `bytes` of a staging buffer that a submitted recording wrote; waits for it.
    pub(crate) fn read_staging<T: bytemuck::Pod>(&self, staging: &wgpu::Buffer, bytes: u64) -> Result<Vec<T>, Error> {
        let slice = staging.slice(0..bytes);
        slice.map_async(wgpu::MapMode::Read, |_| ());
        self.wait()?;
        let data = slice.get_mapped_range().map_err(|e| Error::DeviceLost { reason: e.to_string() })?;
        let values = bytemuck::pod_collect_to_vec(&data);
        drop(data);
        staging.unmap();
        Ok(values)
    }

    /// Reads a whole buffer back; waits for it. For tests, exports and pictures, never within a frame.
    pub(crate) fn read<T: bytemuck::Pod>(
        &self,
        buffer: &wgpu::Buffer,
        offset: u64,
        bytes: u64,
    ) -> Result<Vec<T>, Error> {
        let staging = self.staging("read back", bytes);
        let mut encoder = self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        encoder.copy_buffer_to_buffer(buffer, offset, &staging, 0, bytes);
        self.submit(encoder.finish());
        self.read_staging(&staging, bytes)
    }

    pub(crate) fn take_uniforms(&self) -> wgpu::Buffer {
        let kept = self.shared.uniforms.lock().unwrap_or_else(std::sync::PoisonError::into_inner).pop();
        kept.unwrap_or_else(|| {
            self.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("uniforms"),
                size: crate::recorder::UNIFORM_BYTES,
                usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        })
    }

    pub(crate) fn return_uniforms(&self, buffers: Vec<wgpu::Buffer>) {
        self.shared.uniforms.lock().unwrap_or_else(std::sync::PoisonError::into_inner).extend(buffers);
    }
}

/// Whether an error is of a host application's window, and not of a stage.
fn is_of_window(error: &wgpu::Error) -> bool {
    matches!(error, wgpu::Error::Validation { description, .. } if description.contains("In Surface::configure"))
}

impl Shared {
    fn report(&self, out_of_memory: bool, reason: String) {
        tracing::error!(reason, "the graphics device reported an error");
        let mut error = self.error.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        error.get_or_insert((out_of_memory, reason));
    }
}
