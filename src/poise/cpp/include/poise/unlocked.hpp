// Waiting without Python's lock.
#pragma once

#include <Python.h>
#include <unistd.h>

namespace poise {

// Take the lock again. While Python finalises the interpreter, it ends each thread that does so;
// that thread stays here, for to unwind frames of C++ that may not throw aborts the process.
[[gnu::noinline]] inline void take_lock(PyThreadState* state) {
  struct End {
    ~End() {
      while (is_near) pause();
    }
    bool is_near = true;
  } end;
  PyEval_RestoreThread(state);
  end.is_near = false;
}

// Without the lock for as long as this lives.
class Unlocked {
 public:
  Unlocked() : state_(PyEval_SaveThread()) {}
  ~Unlocked() { take_lock(state_); }
  Unlocked(const Unlocked&) = delete;
  Unlocked& operator=(const Unlocked&) = delete;

 private:
  PyThreadState* state_;
};

}  // namespace poise
