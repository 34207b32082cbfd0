"""Asks drivers which GPUs there are: Taichi says neither what they are called nor if they have double precision."""

import ctypes
import platform
import sys
from dataclasses import dataclass


@dataclass(frozen=True)
class Device:
    """One GPU, or what acts as one.

    name : name that its driver gives it.
    has_f64 : True if it computes in double precision.
    is_software : True if it is in fact the CPU.
    """

    name: str
    has_f64: bool = True
    is_software: bool = False


def find(arch: str) -> list[Device]:
    """Return the GPUs that a backend of Taichi could use; none where there is no driver.

    arch : "cuda", "vulkan" or "metal".
    """
    try:
        return {"cuda": _cuda, "vulkan": _vulkan, "metal": _metal}[arch]()
    except OSError:  # no such library here
        return []


def _cuda() -> list[Device]:
    """Return the GPUs that the CUDA driver knows."""
    driver = ctypes.CDLL("nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1")
    count, devices = ctypes.c_int(), []
    if driver.cuInit(0) or driver.cuDeviceGetCount(ctypes.byref(count)):
        return []
    for number in range(count.value):
        name, device = ctypes.create_string_buffer(256), ctypes.c_int()
        if driver.cuDeviceGet(ctypes.byref(device), number) or driver.cuDeviceGetName(name, len(name), device):
            continue
        devices.append(Device(name.value.decode(errors="replace")))
    return devices


def _metal() -> list[Device]:
    """Return the GPU of a Mac."""
    if sys.platform != "darwin":
        return []
    return [Device(f"GPU of this Mac ({platform.processor() or platform.machine()})", has_f64=False)]


# offsets in VkPhysicalDeviceProperties and VkPhysicalDeviceFeatures, in bytes, and VK_PHYSICAL_DEVICE_TYPE_CPU
DEVICE_TYPE, DEVICE_NAME, NAME_LENGTH, SHADER_FLOAT64, SOFTWARE = 16, 20, 256, 39 * 4, 4


class _Application(ctypes.Structure):
    """The structure VkApplicationInfo of Vulkan's C interface, field by field, for ctypes."""

    _fields_ = (
        ("type", ctypes.c_int), ("next", ctypes.c_void_p), ("name", ctypes.c_char_p), ("version", ctypes.c_uint32),
        ("engine", ctypes.c_char_p), ("engine_version", ctypes.c_uint32), ("api_version", ctypes.c_uint32),
    )  # fmt: skip


class _InstanceInfo(ctypes.Structure):
    """The structure VkInstanceCreateInfo of Vulkan's C interface, field by field, for ctypes."""

    _fields_ = (
        ("type", ctypes.c_int), ("next", ctypes.c_void_p), ("flags", ctypes.c_uint32),
        ("application", ctypes.POINTER(_Application)), ("layers", ctypes.c_uint32), ("layer_names", ctypes.c_void_p),
        ("extensions", ctypes.c_uint32), ("extension_names", ctypes.c_void_p),
    )  # fmt: skip


def _vulkan() -> list[Device]:
    """Return the devices that the Vulkan loader knows."""
    names = {"win32": "vulkan-1.dll", "darwin": "libvulkan.dylib"}
    loader = ctypes.CDLL(names.get(sys.platform, "libvulkan.so.1"))
    application = _Application(type=0, api_version=(1 << 22) | (1 << 12))  # Vulkan 1.1
    info, instance = _InstanceInfo(type=1, application=ctypes.pointer(application)), ctypes.c_void_p()
    if loader.vkCreateInstance(ctypes.byref(info), None, ctypes.byref(instance)):
        return []
    count, devices = ctypes.c_uint32(), []
    loader.vkEnumeratePhysicalDevices(instance, ctypes.byref(count), None)
    handles = (ctypes.c_void_p * count.value)()
    loader.vkEnumeratePhysicalDevices(instance, ctypes.byref(count), handles)
    for handle in handles[: count.value]:
        properties, features = ctypes.create_string_buffer(4096), ctypes.create_string_buffer(1024)
        loader.vkGetPhysicalDeviceProperties(ctypes.c_void_p(handle), properties)
        loader.vkGetPhysicalDeviceFeatures(ctypes.c_void_p(handle), features)
        name = properties.raw[DEVICE_NAME : DEVICE_NAME + NAME_LENGTH].split(b"\0")[0].decode(errors="replace")
        kind = int.from_bytes(properties.raw[DEVICE_TYPE : DEVICE_TYPE + 4], sys.byteorder)
        has_f64 = any(features.raw[SHADER_FLOAT64 : SHADER_FLOAT64 + 4])
        devices.append(Device(name, has_f64, is_software=kind == SOFTWARE))
    loader.vkDestroyInstance(instance, None)
    return devices
