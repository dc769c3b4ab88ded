# Builds for another system, by Clang of the package ziglang, which has the headers and libraries of all of them.
#
# COADJOINT_TARGET is zig's name of the system, such as aarch64-macos; COADJOINT_PYTHON an interpreter with ziglang.
list(APPEND CMAKE_TRY_COMPILE_PLATFORM_VARIABLES COADJOINT_TARGET COADJOINT_PYTHON)
set(CMAKE_TRY_COMPILE_TARGET_TYPE STATIC_LIBRARY)
string(REGEX MATCH "^([a-z0-9_]+)-([a-z]+)" target "${COADJOINT_TARGET}")
set(CMAKE_SYSTEM_PROCESSOR "${CMAKE_MATCH_1}")
set(name_of_linux Linux)
set(name_of_macos Darwin)
set(name_of_windows Windows)
set(CMAKE_SYSTEM_NAME "${name_of_${CMAKE_MATCH_2}}")
set(CMAKE_CXX_COMPILER "${COADJOINT_PYTHON}" "${CMAKE_CURRENT_LIST_DIR}/zig.py" "--target=${COADJOINT_TARGET}")
if(CMAKE_SYSTEM_NAME STREQUAL "Linux")
  set(CMAKE_MODULE_LINKER_FLAGS_INIT "-Wl,-z,defs")
elseif(CMAKE_SYSTEM_NAME STREQUAL "Darwin")
  # CMake looks for tools of Apple, of which nothing here is used.
  set(CMAKE_INSTALL_NAME_TOOL "${CMAKE_COMMAND}")
endif()
