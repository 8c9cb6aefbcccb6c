// How components in C++ call each other within a container: what poise.runtime._calls offers them.
//
// A call begins and ends without Python's GIL, in the code that calls of Python components run, too:
// exclusion, limits and counts are the same.
#pragma once

#include <Python.h>

#include <cstdint>

namespace poise {

constexpr const char* calls_api_name = "poise.calls_api";

enum class Begin { entered, redirected, refused };

// A call within a container while it runs.
struct RunningDirectCall {
  std::int64_t began = 0, inside = 0, cpu_began = 0, deadline_before = 0;  // [ns]
  double limit = 0.0;                                                     // [s]
  bool measured = false, is_outermost = false;
  char refusal[256];  // why a Timeout is raised; set when `begin` refuses, and when `end` is late
};

// In the capsule that `poise.runtime._calls.native_api` returns.
struct CallsApi {
  // What is inside a function that `direct_call` returned; null: it is another function. And the
  // method that it calls, borrowed. Under the GIL.
  void* (*find)(PyObject* function);
  PyObject* (*method)(void* call);
  // Enter the callee's exclusion, within the call's limit. After `entered`, `end` must follow: it
  // leaves, counts, and returns whether the result came in time. With or without the GIL.
  Begin (*begin)(void* call, RunningDirectCall& run);
  bool (*end)(void* call, RunningDirectCall& run, bool failed);
};

}  // namespace poise
