# The recognition library and its process. OpenCV's small packages have no CMake config: found by name.
foreach(part core imgproc features2d)
    find_library(OPENCV_${part} opencv_${part} REQUIRED)
    list(APPEND opencv_libraries ${OPENCV_${part}})
endforeach()
find_path(OPENCV_INCLUDE opencv2/core.hpp PATH_SUFFIXES opencv4 REQUIRED)
find_package(SQLite3 REQUIRED)

add_library(noctule_recognise STATIC ${recognise_sources})
target_include_directories(noctule_recognise SYSTEM PUBLIC ${OPENCV_INCLUDE})
target_link_libraries(noctule_recognise PUBLIC noctule_firmware SQLite::SQLite3 ${opencv_libraries} PRIVATE noctule_options)

if(EXISTS ${CMAKE_SOURCE_DIR}/firmware/app/vision_main.cpp)
    add_executable(noctule-vision firmware/app/vision_main.cpp)
    target_link_libraries(noctule-vision PRIVATE noctule_app noctule_recognise noctule_options)
endif()
