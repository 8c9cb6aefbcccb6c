// What a call through a required port throws, and what C++ exceptions become in Python.
#pragma once

#include <cxxabi.h>
#include <nanobind/nanobind.h>

#include <cstdlib>
#include <memory>
#include <stdexcept>
#include <string>
#include <typeinfo>

#include "unlocked.hpp"

namespace poise {

namespace nb = nanobind;

// A call did not bring back a result.
struct CallError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

// Nobody is at the other end.
struct Unavailable : CallError {
  using CallError::CallError;
};

// The answer did not come within the connector's limit; the callee may still have run.
struct Timeout : CallError {
  using CallError::CallError;
};

// An argument or the result is not of the type that the interface declares, or too large.
struct CannotCross : CallError {
  using CallError::CallError;
};

// The callee raised, in whatever language.
struct CalleeError : CallError {
  CalleeError(std::string type, std::string text, std::string trace = "")
      : CallError(type + ": " + text),
        type_name(std::move(type)),
        message(std::move(text)),
        traceback(std::move(trace)) {}
  std::string type_name, message, traceback;
};

namespace detail {

inline nb::object from_python(const char* module, const char* name) {
  return nb::module_::import_(module).attr(name);
}

// Text for Python; what is not UTF-8 is escaped.
inline nb::object text_from(const std::string& text) {
  return nb::steal(PyUnicode_DecodeUTF8(text.data(), static_cast<Py_ssize_t>(text.size()),
                                        "backslashreplace"));
}

// What an object of Python's says, also when that is no text which can be sent.
inline std::string said(nb::handle object) {
  return nb::cast<std::string>(from_python("poise.errors", "said")(object));
}

inline std::string demangled(const char* mangled) {
  int status = 0;
  const std::unique_ptr<char, void (*)(void*)> name(
      abi::__cxa_demangle(mangled, nullptr, nullptr, &status), std::free);
  return name ? name.get() : mangled;
}

// What code threw: the name of its type, and what it says.
struct Thrown {
  std::string type_name, message;
};

// Of the exception that is being handled.
inline Thrown thrown() {
  try {
    throw;
  } catch (nb::python_error& error) {
    const Locked lock;
    return {nb::cast<std::string>(error.type().attr("__qualname__")), said(error.value())};
  } catch (const std::exception& error) {
    std::string name = demangled(typeid(error).name());
    if (name.rfind("poise::", 0) == 0) name.erase(0, 7);
    return {name, error.what()};
  } catch (...) {
    const std::type_info* type = abi::__cxa_current_exception_type();
    return {type ? demangled(type->name()) : "unknown", "not a std::exception"};
  }
}

inline nb::object cpp_error(const Thrown& what) {
  return from_python("poise.runtime.hosting.cpp_component", "error")(what.type_name,
                                                                     text_from(what.message));
}

// Whether an error is of one of these classes, and not of one that inherits from it.
template <typename... Classes>
bool is_exactly(const CallError& error) {
  return ((typeid(error) == typeid(Classes)) || ...);
}

// Let what is being handled go on as an error of Python's.
[[noreturn]] inline void raise_in_python() {
  nb::object error;
  try {
    throw;
  } catch (nb::python_error&) {
    throw;
  } catch (nb::builtin_exception&) {
    throw;
  } catch (const CalleeError& e) {
    error = from_python("poise.errors", "CalleeError")(
        text_from(e.type_name), text_from(e.message), text_from(e.traceback));
  } catch (const CallError& e) {
    const Thrown what = thrown();
    error = is_exactly<CallError, Unavailable, Timeout, CannotCross>(e)
                ? from_python("poise.errors", what.type_name.c_str())(text_from(what.message))
                : cpp_error(what);
  } catch (...) {
    error = cpp_error(thrown());
  }
  PyErr_SetObject(error.type().ptr(), error.ptr());
  throw nb::python_error();
}

// Throw what an error of a call stands for; others go on as they are.
[[noreturn]] inline void throw_call_error(nb::python_error& error) {
  const auto is = [&](const char* name) {
    return error.matches(from_python("poise.errors", name));
  };
  const auto text = [&](const char* name) { return said(error.value().attr(name)); };
  if (is("CalleeError")) throw CalleeError(text("type_name"), text("message"), text("traceback"));
  const std::string message = said(error.value());
  if (is("Unavailable")) throw Unavailable(message);
  if (is("Timeout")) throw Timeout(message);
  if (is("CannotCross")) throw CannotCross(message);
  if (is("CallError")) throw CallError(message);
  throw error;
}

// Run code of a component's without the interpreter's lock, which the caller holds.
template <typename Function>
auto run_released(Function&& function) {
  try {
    const Unlocked unlocked;
    return function();
  } catch (...) {
    raise_in_python();
  }
}

}  // namespace detail
}  // namespace poise
