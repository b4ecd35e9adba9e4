# The recognition library and its process. OpenCV's small packages have no CMake config: found by name.
foreach(part core imgproc features2d)
    find_library(OPENCV_${part} opencv_${part} REQUIRED)
    list(APPEND opencv_libraries ${OPENCV_${part}})
endforeach()
find_path(OPENCV_INCLUDE opencv2/core.hpp PATH_SUFFIXES opencv4 REQUIRED)
find_package(SQLite3 REQUIRED)
find_package(Eigen3 3.4 REQUIRED NO_MODULE)

add_library(noctule_recognise STATIC ${recognise_sources})
target_include_directories(noctule_recognise SYSTEM PUBLIC ${OPENCV_INCLUDE})
target_link_libraries(noctule_recognise PUBLIC noctule_firmware Eigen3::Eigen SQLite::SQLite3 ${opencv_libraries} PRIVATE noctule_options)

set_target_properties(noctule_recognise PROPERTIES POSITION_INDEPENDENT_CODE ON)

add_library(noctule_vision_node STATIC firmware/app/vision_node.cpp)
target_link_libraries(noctule_vision_node PUBLIC noctule_app noctule_recognise PRIVATE noctule_options)
set_target_properties(noctule_vision_node PROPERTIES POSITION_INDEPENDENT_CODE ON)
add_executable(noctule-vision firmware/app/vision_main.cpp)
target_link_libraries(noctule-vision PRIVATE noctule_vision_node noctule_options)

# For Python: the recognition in-process; and, where dlib is installed, its SURF as the bench's reference (dlib's templates are not held to our warnings).
if(NOT NOCTULE_SANITIZE)
    add_library(noctule_vision_abi SHARED firmware/app/vision_abi.cpp)
    target_link_libraries(noctule_vision_abi PRIVATE noctule_vision_node noctule_options)
    find_path(DLIB_INCLUDE dlib/image_keypoint.h)
    if(DLIB_INCLUDE)
        add_library(noctule_bench_dlib SHARED tests/bench/dlib_surf.cpp)
        target_include_directories(noctule_bench_dlib SYSTEM PRIVATE ${DLIB_INCLUDE})
        target_compile_definitions(noctule_bench_dlib PRIVATE DLIB_NO_GUI_SUPPORT)
        target_compile_options(noctule_bench_dlib PRIVATE -ffp-contract=off)
        target_link_options(noctule_bench_dlib PRIVATE -Wl,--no-undefined)
    endif()
endif()

# ---- the camera's driver: OpenCV's video part, which may allocate, too
find_library(OPENCV_videoio opencv_videoio REQUIRED)
add_executable(noctule-camera firmware/app/camera_main.cpp firmware/drivers/camera_source.cpp)
target_include_directories(noctule-camera SYSTEM PRIVATE ${OPENCV_INCLUDE})
target_link_libraries(noctule-camera PRIVATE noctule_app ${OPENCV_videoio} ${opencv_libraries} noctule_options)
