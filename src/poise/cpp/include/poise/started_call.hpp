// Calls that are not waited for, or only for some time.
#pragma once

#include "ports.hpp"

namespace poise {

// The result of a call that was cancelled is asked for.
struct Cancelled : std::runtime_error {
  using std::runtime_error::runtime_error;
};

// A call that a component started. Any thread may use it.
template <typename Result>
class StartedCall {
 public:
  StartedCall(nb::object call, nb::handle method)
      : call_(new nb::object(std::move(call)), release), method_(method) {}

  // Whether it was answered, failed, or was cancelled.
  bool done() const { return ask("done"); }
  // Drop the answer; whether it was still to come. The callee makes a call to its end.
  bool cancel() const { return ask("cancel"); }
  // Wait for the result, within the connector's limit; throws CallError, or Cancelled.
  Result result() const {
    const Locked lock;
    try {
      return detail::result_from<Result>(call_->attr("result")(), method_);
    } catch (nb::python_error& error) {
      if (error.matches(detail::from_python("concurrent.futures", "CancelledError")))
        throw Cancelled(nb::cast<std::string>(method_) + " was cancelled");
      detail::throw_call_error(error);
    }
  }
  // Let the component take the answer, as a message: `take` gets this call.
  template <typename Take>
  void then(Take take) const {
    const Locked lock;
    const auto method = method_;
    call_->attr("then")(nb::cpp_function([take, method](nb::object call) {
      const StartedCall started(std::move(call), method);
      detail::run_released([&] { take(started); });
    }));
  }

 private:
  static void release(nb::object* call) {
    const Locked lock;
    delete call;
  }
  bool ask(const char* what) const {
    const Locked lock;
    return nb::cast<bool>(call_->attr(what)());
  }

  std::shared_ptr<nb::object> call_;
  nb::handle method_;  // its name, interned for good
};

// While it exists, calls that this thread makes or starts are given up in time, by Timeout.
class Within {
 public:
  explicit Within(double seconds) {
    const Locked lock;
    nb::object block = detail::from_python("poise", "within")(seconds);
    block.attr("__enter__")();  // what this throws ends the block under the lock
    block_ = std::move(block);
  }
  ~Within() {
    const Locked lock;
    block_.attr("__exit__")(nb::none(), nb::none(), nb::none());
    block_.reset();
  }
  Within(const Within&) = delete;

 private:
  nb::object block_;
};

}  // namespace poise
