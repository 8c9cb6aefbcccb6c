# find_package(poise) gives poise_add_component (docs/cpp-components.md).
#
# It is installed twice: in Poise's package, for -Dpoise_DIR=$(python -m poise.cmake), and where
# CMake finds it by itself when the environment of that Python is active.
find_package(Python 3.11 REQUIRED COMPONENTS Interpreter Development.Module)
execute_process(
  COMMAND ${Python_EXECUTABLE} -c "from poise.cmake import *; print(folder(), release(), sep=';')"
  OUTPUT_STRIP_TRAILING_WHITESPACE OUTPUT_VARIABLE poise_SAID RESULT_VARIABLE poise_FAILED)
if(poise_FAILED)
  message(FATAL_ERROR "Poise is not installed for ${Python_EXECUTABLE}: activate the environment "
                      "that has it, or give -DPython_EXECUTABLE=")
endif()
list(GET poise_SAID 0 poise_FOLDER)
list(GET poise_SAID 1 poise_RELEASE)
# when the headers are others, so is the release
file(GLOB poise_HEADERS ${poise_FOLDER}/include/poise/*.hpp)
set_property(DIRECTORY APPEND PROPERTY CMAKE_CONFIGURE_DEPENDS ${poise_HEADERS})
if(NOT nanobind_FOUND)
  execute_process(
    COMMAND ${Python_EXECUTABLE} -m nanobind --cmake_dir
    OUTPUT_STRIP_TRAILING_WHITESPACE OUTPUT_VARIABLE nanobind_ROOT RESULT_VARIABLE poise_FAILED)
  if(poise_FAILED)
    message(FATAL_ERROR "components in C++ need nanobind: pip install 'poise[cpp]'")
  endif()
  find_package(nanobind CONFIG REQUIRED)
endif()
if(NOT CMAKE_BUILD_TYPE AND NOT CMAKE_CONFIGURATION_TYPES)
  set(CMAKE_BUILD_TYPE Release CACHE STRING "How components are compiled" FORCE)
endif()

# poise_add_component(module SOURCES file... [OUTPUT folder])
#
# Builds the components in these files into a Python module, beside the CMakeLists.txt or in
# another folder: `implementation: "module:Class"`.
function(poise_add_component module)
  cmake_parse_arguments(PARSE_ARGV 1 ARG "" "OUTPUT" "SOURCES")
  if(NOT ARG_SOURCES OR ARG_UNPARSED_ARGUMENTS)
    message(FATAL_ERROR "poise_add_component(${module} SOURCES file.cpp ... [OUTPUT folder])")
  endif()
  if(NOT ARG_OUTPUT)
    set(ARG_OUTPUT ${CMAKE_CURRENT_SOURCE_DIR})
  endif()
  set(init ${CMAKE_CURRENT_BINARY_DIR}/${module}_module.cpp)
  file(CONFIGURE OUTPUT ${init}
       CONTENT "#include <poise/component.hpp>\nPOISE_MODULE(${module})\n")
  nanobind_add_module(${module} NB_STATIC NOMINSIZE ${init} ${ARG_SOURCES})
  target_compile_features(${module} PRIVATE cxx_std_20)
  target_compile_definitions(${module} PRIVATE
    POISE_MODULE_NAME="${module}" POISE_BUILT_FOR="${poise_RELEASE}")
  target_include_directories(${module} SYSTEM PRIVATE ${poise_FOLDER}/include)
  set_target_properties(${module} PROPERTIES LIBRARY_OUTPUT_DIRECTORY ${ARG_OUTPUT})
endfunction()
